"""Flat pictures as plain data: shapes in metres seen from above, with no plotting library behind.

World x runs to the right of the page and y up; `reset_image.py` makes pixels of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from codediffuser.datagen.scene import SceneSpec

if TYPE_CHECKING:
    from codediffuser.datagen.task import Observer

Point = tuple[float, float]
"""World x and y, metres."""
Color = str
"""`#rrggbb`, as displays take it."""

INK: Color = "#22262b"
FAINT: Color = "#8b929c"
CRATE: Color = "#8f959d"
EMPTY: Color = "#ffffff"
PAD: Color = "#fbf3e6"
PAD_EDGE: Color = "#d9c7a6"
OBJECT: Color = "#f26a1b"
OBJECT_EDGE: Color = "#b0450a"
TARGET: Color = "#21b24b"
TARGET_EDGE: Color = "#0e7a2f"
TARGET_TINT: Color = "#d5f2dc"
BORDER_M = 0.02
"""Empty table that is shown around everything."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A filled circle; dashed ones stand for what is not there yet."""

    center_m: Point
    radius_m: float
    fill: Color | None
    edge: Color
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Box:
    """A filled rectangle along the axes."""

    low_m: Point
    high_m: Point
    fill: Color
    edge: Color | None = None


@dataclass(frozen=True, slots=True)
class Cross:
    """A marker that has its counterpart on the real pad."""

    center_m: Point
    size_m: float
    color: Color = FAINT


@dataclass(frozen=True, slots=True)
class Arrow:
    """From what is picked to where it goes."""

    start_m: Point
    end_m: Point
    color: Color = TARGET_EDGE


@dataclass(frozen=True, slots=True)
class Text:
    """Words at a point."""

    at_m: Point
    text: str
    size_pt: float
    color: Color = INK
    bold: bool = False
    align: Literal["left", "center", "right"] = "center"


Shape = Disc | Box | Cross | Arrow | Text


@dataclass(frozen=True, slots=True)
class Sides:
    """What stands at the four edges of the page, in the operator's words."""

    top: str
    bottom: str
    left: str
    right: str


@dataclass(frozen=True, slots=True)
class Drawing:
    """One picture: shapes in the order they are painted, and the words around them."""

    title: str
    notes: tuple[str, ...]
    """Short facts under the title: `3 on the pad`."""
    sentence: str
    """The instruction, shown in full."""
    sides: Sides
    low_m: Point
    high_m: Point
    """Corners of the part of the table that is shown."""
    shapes: tuple[Shape, ...]


def grid_of_cells(
    center_m: Point, size_m: Point, rows: int, columns: int, pitch_m: float, wall_m: float
) -> list[Shape]:
    """A crate from above: a plate of `size_m` with rows x columns white cells in it."""
    half_x, half_y = size_m[0] / 2, size_m[1] / 2
    shapes: list[Shape] = [
        Box(
            (center_m[0] - half_x, center_m[1] - half_y),
            (center_m[0] + half_x, center_m[1] + half_y),
            fill=CRATE,
        )
    ]
    for row in range(rows):
        for column in range(columns):
            x = center_m[0] + (column - (columns - 1) / 2) * pitch_m
            y = center_m[1] + (row - (rows - 1) / 2) * pitch_m
            shapes.append(cell((x, y), pitch_m, wall_m, EMPTY))
    return shapes


def cell(center_m: Point, pitch_m: float, wall_m: float, fill: Color) -> Box:
    """The inside of one cell of a grid."""
    half = (pitch_m - wall_m) / 2
    return Box(
        (center_m[0] - half, center_m[1] - half), (center_m[0] + half, center_m[1] + half), fill
    )


def pad_with_crosses(low_m: Point, high_m: Point, spacing_m: float) -> list[Shape]:
    """A pad with crosses at every whole multiple of `spacing_m`, labelled in cm along two edges.

    The crosses lie at world coordinates, so they stay in place from picture to picture and can be
    marked once on the real pad.
    """
    shapes: list[Shape] = [Box(low_m, high_m, fill=PAD, edge=PAD_EDGE)]
    xs, ys = (
        spacing_m
        * np.arange(np.ceil(low / spacing_m - 1e-9), np.floor(high / spacing_m + 1e-9) + 1)
        for low, high in zip(low_m, high_m, strict=True)
    )
    shapes += [Cross((float(x), float(y)), spacing_m / 5) for y in ys for x in xs]
    gap = spacing_m / 5
    for x in xs:
        shapes.append(Text((float(x), low_m[1] - gap), _cm(float(x)), 8, FAINT))
    for y in ys:
        shapes.append(Text((low_m[0] - gap, float(y)), _cm(float(y)), 8, FAINT))
    shapes.append(Text((low_m[0] - gap, low_m[1] - gap), "cm", 8, FAINT))
    return shapes


def thing(center_m: Point, radius_m: float, *, target: bool) -> Disc:
    """An object, orange, or green when it is the one to pick."""
    fill, edge = (TARGET, TARGET_EDGE) if target else (OBJECT, OBJECT_EDGE)
    return Disc(center_m, radius_m, fill, edge)


def arrow_between(
    start_m: Point, start_radius_m: float, end_m: Point, end_radius_m: float
) -> Arrow:
    """An arrow from the rim of one circle to the rim of another."""
    start, end = np.array(start_m), np.array(end_m)
    step = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    tail, head = start + step * start_radius_m, end - step * end_radius_m
    return Arrow((float(tail[0]), float(tail[1])), (float(head[0]), float(head[1])))


def reset_drawing(
    scene: SceneSpec, shapes: Sequence[Shape], observer: Observer, *,
    low_m: Point, high_m: Point, notes: tuple[str, ...],
) -> Drawing:  # fmt: skip
    """Frame shapes as the picture to reset a scene by: its number, its sentence, the four sides.

    The page shows the table from above with +y up and the robot below. Its sides carry the words
    that instructions use, so that picture and sentence never disagree.
    """
    return Drawing(
        title=f"Episode {int(scene.scene_id)}",
        notes=(scene.task, *notes),
        sentence=scene.instruction.text,
        sides=Sides(
            top=_spoken(observer, (0, 1)),
            bottom=f"{_spoken(observer, (0, -1))}  ·  the robot, and you, stand here",
            left=_spoken(observer, (-1, 0)),
            right=_spoken(observer, (1, 0)),
        ),
        low_m=(low_m[0] - BORDER_M, low_m[1] - BORDER_M),
        high_m=(high_m[0] + BORDER_M, high_m[1] + BORDER_M),
        shapes=tuple(shapes),
    )


def _spoken(observer: Observer, direction: Point) -> str:
    """The word of the four that comes nearest to a world direction."""
    words = {
        "left": observer.left,
        "right": observer.right,
        "front": observer.front,
        "back": observer.back,
    }
    return max(words, key=lambda word: float(np.dot(words[word], direction)))


def _cm(value_m: float) -> str:
    return f"{100 * value_m:+.0f}" if abs(value_m) > 1e-9 else "0"
