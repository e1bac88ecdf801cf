"""The reset picture of a bookshelf: the row from the front, with titles, and the pad from above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen import drawing
from codediffuser.datagen.book_slots import row_beside, shelved_books, slot_corners_m
from codediffuser.datagen.bookshelf import ShelfConfig
from codediffuser.datagen.scene import ObjectSpec, SceneSpec, Vector3
from codediffuser.datagen.spine import ink_rgb

if TYPE_CHECKING:
    from codediffuser.datagen.task import Pad
    from codediffuser.datagen.task_config import Observer

BACK: drawing.Color = "#efece7"
OUTLINE_PT = 3.0


def shelf_from_front(scene: SceneSpec, shelf: ShelfConfig) -> drawing.Panel:
    """The row as somebody at the robot sees it; the slot that the new book goes to is green."""
    inner = scene.object("shelf").shape["inner_width_m"]
    half, wall = inner / 2, shelf.wall_m
    wood = drawing.display_color(shelf.color_rgb)
    shapes: list[drawing.Shape] = [
        drawing.Box((-half - wall, 0.0), (half + wall, shelf.height_m), wood),
        drawing.Box((-half, shelf.floor_m), (half, shelf.height_m), BACK),
    ]
    for book in shelved_books(scene):
        shapes += _book_from_front(book)
    left, right = row_beside(scene, scene.target.place)
    top = shelf.floor_m + min(left[-1].shape["height_m"], right[0].shape["height_m"])
    corners = slot_corners_m(left[-1], right[0], (shelf.floor_m, top))
    outline = tuple((float(x), float(z)) for x, z in corners)
    shapes.append(
        drawing.Polygon(outline, drawing.TARGET_TINT, drawing.TARGET, width_pt=OUTLINE_PT)
    )
    middle = corners.mean(axis=0)
    shapes.append(
        drawing.Text(
            (float(middle[0]), float(middle[1])), "to here", 8, drawing.TARGET_EDGE, bold=True,
            rotation_rad=-np.pi / 2,
        )
    )  # fmt: skip
    return drawing.from_front(shapes, (-half - wall, 0.0), (half + wall, shelf.height_m))


def pad_from_above(scene: SceneSpec, pad: Pad, observer: Observer) -> drawing.Panel:
    """The pad with its crosses, and the book that waits on it, outlined in green."""
    (book,) = scene.pickable
    T, (half_x, half_y) = book.T_world_object, _half_size(book)
    corners = [T @ [x, y, 0, 1] for x, y in _rectangle(half_x, half_y)]
    outline = tuple((float(c[0]), float(c[1])) for c in corners)
    ends = [T @ [0, y, 0, 1] for y in (-half_y, half_y)]
    spine = drawing.Line(outline[0], outline[1], drawing.TARGET_EDGE, width_pt=2 * OUTLINE_PT)
    along = ends[1][:2] - ends[0][:2]
    shapes: list[drawing.Shape] = [
        *drawing.pad_with_crosses(pad),
        drawing.Polygon(
            outline, drawing.display_color(book.color_rgb), drawing.TARGET, width_pt=OUTLINE_PT
        ),
        spine,
        drawing.Text(
            book.position_m[:2], book.label or "", 9, _ink(book.color_rgb), bold=True,
            rotation_rad=float(np.arctan2(along[1], along[0])), fit_m=1.8 * half_y,
        ),
        drawing.Text(
            (outline[0][0] - 0.012, outline[0][1] + 0.004), "spine", 8, drawing.TARGET_EDGE,
            bold=True, align="right",
        ),
    ]  # fmt: skip
    return drawing.from_above(shapes, observer, pad.low_m, pad.high_m)


def _book_from_front(book: ObjectSpec) -> list[drawing.Shape]:
    T, height, half_x = book.T_world_object, book.shape["height_m"], _half_size(book)[0]
    corners = [
        T @ [x, 0, z, 1]
        for x, z in ((-half_x, 0), (half_x, 0), (half_x, height), (-half_x, height))
    ]
    middle = T @ [0, 0, height / 2, 1]
    down = float(np.arctan2(-T[2, 2], -T[0, 2]))
    return [
        drawing.Polygon(
            tuple((float(c[0]), float(c[2])) for c in corners),
            drawing.display_color(book.color_rgb), drawing.INK, width_pt=0.6,
        ),
        drawing.Text(
            (float(middle[0]), float(middle[2])), book.label or "", 14, _ink(book.color_rgb),
            bold=True, rotation_rad=down, fit_m=0.88 * height,
        ),
    ]  # fmt: skip


def _rectangle(half_x: float, half_y: float) -> list[tuple[float, float]]:
    return [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]


def _half_size(book: ObjectSpec) -> tuple[float, float]:
    return book.shape["thickness_m"] / 2, book.shape["depth_m"] / 2


def _ink(color_rgb: Vector3) -> drawing.Color:
    return "#" + "".join(f"{channel:02x}" for channel in ink_rgb(color_rgb))
