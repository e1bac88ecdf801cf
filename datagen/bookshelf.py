"""A shelf of books: sizes, bodies, and the frame that a book has.

A book's origin is the middle of its base; x runs through its thickness, y from the spine to the
fore-edge, z up. On the shelf its spine faces -y, toward the robot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import model_validator

from codediffuser.datagen import shapes
from codediffuser.datagen.scene import ObjectSpec, Vector3
from codediffuser.datagen.spine import TitleStyle, book_decal
from codediffuser.datagen.task import Geometry
from codediffuser.poses import matrix_to_quat_wxyz
from codediffuser.schema import Strict

if TYPE_CHECKING:
    import trimesh


class BookConfig(Strict):
    """One book of the catalogue."""

    color: str
    """How its colour is called; a key of `books.colors`."""
    thickness_m: float
    height_m: float


class BooksConfig(Strict):
    """All books, by title, and what they have in common."""

    depth_m: float
    """From spine to fore-edge."""
    bevel_m: tuple[float, float]
    """How much the long edges of spine and fore-edge are rounded: across, and along the depth."""
    density_kgm3: float
    friction: float
    colors: dict[str, Vector3]
    """Linear RGB by name."""
    titles: TitleStyle
    catalogue: dict[str, BookConfig]

    @model_validator(mode="after")
    def _colors_are_known(self) -> Self:
        for title, book in self.catalogue.items():
            if book.color not in self.colors:
                raise ValueError(
                    f"books.catalogue.{title}.color: '{book.color}' is no key of books.colors"
                )
            if book.thickness_m <= 2 * self.bevel_m[0]:
                raise ValueError(
                    f"books.catalogue.{title}.thickness_m: expected more than twice the bevel"
                )
        return self


class ShelfConfig(Strict):
    """A shelf without a top board, open toward the robot; its middle stands at x = 0."""

    spine_y_m: float
    """Plane in which the spines of the standing books lie."""
    floor_m: float
    """Height of its floor above the table."""
    lip_m: float
    """How far the floor reaches out before the spines."""
    back_gap_m: float
    """Between the fore-edges and the back."""
    wall_m: float
    height_m: float
    """Of the walls and the back, above the table."""
    color_rgb: Vector3


def shelf_object(shelf: ShelfConfig, inner_width_m: float, depth_m: float) -> ObjectSpec:
    """The shelf itself; its origin lies on the table in the plane of the spines."""
    return ObjectSpec(
        id="shelf",
        category="shelf",
        name="shelf",
        position_m=(0.0, shelf.spine_y_m, 0.0),
        color_rgb=shelf.color_rgb,
        fixed=True,
        shape={"inner_width_m": inner_width_m, "inner_depth_m": depth_m + shelf.back_gap_m},
    )


def book_object(
    books: BooksConfig, title: str, object_id: str, T_world_book: np.ndarray, *,
    place: str | None = None, fixed: bool = False,
) -> ObjectSpec:  # fmt: skip
    """A book of the catalogue at a pose (4, 4)."""
    book = books.catalogue[title]
    x, y, z = (float(v) for v in T_world_book[:3, 3])
    qw, qx, qy, qz = (float(v) for v in matrix_to_quat_wxyz(T_world_book[:3, :3]))
    return ObjectSpec(
        id=object_id,
        category="book",
        name=f"{book.color} book",
        position_m=(x, y, z),
        quat_wxyz=(qw, qx, qy, qz),
        color_rgb=books.colors[book.color],
        place=place,
        fixed=fixed,
        label=title,
        shape={
            "thickness_m": book.thickness_m, "height_m": book.height_m, "depth_m": books.depth_m,
        },
    )  # fmt: skip


def book_geometry(obj: ObjectSpec, books: BooksConfig) -> Geometry:
    """One convex body with bevelled long edges, its title on the spine, pages on top."""
    size = (obj.shape["thickness_m"], obj.shape["depth_m"], obj.shape["height_m"])
    body = book_body(size, books.bevel_m)
    return Geometry(
        visual=body,
        collision=(body,),
        density_kgm3=books.density_kgm3,
        static_friction=books.friction,
        dynamic_friction=books.friction,
        restitution=0.0,
        decals=(book_decal(obj.label or "", obj.color_rgb, size, books.bevel_m, books.titles),),
    )


def book_outline(size_m: Vector3, bevel_m: tuple[float, float]) -> np.ndarray:
    """Corners (8, 2) of a book from above, counter-clockwise from the left of the spine, metres."""
    half_x, half_y = size_m[0] / 2, size_m[1] / 2
    across, along = bevel_m
    spine = [(-half_x + across, -half_y), (half_x - across, -half_y)]
    right = [(half_x, -half_y + along), (half_x, half_y - along)]
    front = [(half_x - across, half_y), (-half_x + across, half_y)]
    left = [(-half_x, half_y - along), (-half_x, -half_y + along)]
    return np.array([*spine, *right, *front, *left])


def book_body(size_m: Vector3, bevel_m: tuple[float, float]) -> trimesh.Trimesh:
    """The convex body of a book of size (thickness, depth, height)."""
    import trimesh

    outline = book_outline(size_m, bevel_m)
    rings = [np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, size_m[2])]
    return trimesh.convex.convex_hull(np.concatenate(rings))


def shelf_geometry(obj: ObjectSpec, shelf: ShelfConfig, friction: float) -> Geometry:
    """Floor, two walls and a back, in the frame of `shelf_object`."""
    import trimesh

    half, depth = obj.shape["inner_width_m"] / 2, obj.shape["inner_depth_m"]
    wall, height = shelf.wall_m, shelf.height_m
    boxes = [
        [[-half - wall, -shelf.lip_m, 0.0], [half + wall, depth + wall, shelf.floor_m]],
        [[-half - wall, -shelf.lip_m, shelf.floor_m], [-half, depth + wall, height]],
        [[half, -shelf.lip_m, shelf.floor_m], [half + wall, depth + wall, height]],
        [[-half, depth, shelf.floor_m], [half, depth + wall, height]],
    ]
    parts = [trimesh.creation.box(bounds=bounds) for bounds in boxes]
    return Geometry(
        visual=shapes.join(parts),
        collision=tuple(parts),
        static_friction=friction,
        dynamic_friction=friction,
        restitution=0.0,
    )
