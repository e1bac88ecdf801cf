"""Flat pictures as plain data: shapes in metres, with no plotting library behind.

A `Drawing` is one page with one or more panels side by side, all at one scale. Seen from above,
world x runs to the right of a panel and y up; seen from the front, z runs up. `reset_image.py`
makes pixels of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from codediffuser.datagen.scene import SceneSpec

if TYPE_CHECKING:
    from codediffuser.datagen.task import Pad
    from codediffuser.datagen.task_config import Observer

Point = tuple[float, float]
"""Across and up in a panel, metres; world x and y where the panel looks from above."""
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
HANDLE: Color = "#1f3fd6"
"""The line that shows which way a handle points."""
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
class Line:
    """A straight stroke."""

    start_m: Point
    end_m: Point
    color: Color = INK
    width_pt: float = 1.6


@dataclass(frozen=True, slots=True)
class Polygon:
    """A closed outline of any number of corners: a book that leans, a branch."""

    corners_m: tuple[Point, ...]
    fill: Color | None
    edge: Color | None = None
    width_pt: float = 1.0


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
    """Which part of the line of words stands at `at_m`; its middle height always does."""
    rotation_rad: float = 0.0
    """Counter-clockwise: pi / 2 reads upwards, -pi / 2 downwards as on a spine."""
    fit_m: float | None = None
    """Length that the words must not exceed; the size shrinks until they fit."""


View = Literal["above", "front"]
"""Where a panel is seen from; only a panel from above has the world's x and y on the page."""
Shape = Disc | Box | Line | Polygon | Cross | Arrow | Text


@dataclass(frozen=True, slots=True)
class Sides:
    """What stands at the four edges of a panel, in the operator's words; "" leaves one empty."""

    top: str = ""
    bottom: str = ""
    left: str = ""
    right: str = ""
    robot: bool = False
    """Whether the bottom edge is where the robot stands; it is then marked by a dark bar."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One view of the scene: shapes in the order they are painted."""

    low_m: Point
    high_m: Point
    """Corners of the part of the world that is shown."""
    shapes: tuple[Shape, ...]
    sides: Sides = Sides()
    view: View = "above"


@dataclass(frozen=True, slots=True)
class Drawing:
    """One page: views side by side at one scale, and the words above them."""

    title: str
    notes: tuple[str, ...]
    """Short facts beside the title: `3 on the pad`."""
    sentence: str
    """The instruction, shown in full."""
    panels: tuple[Panel, ...]
    """From left to right."""

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes of all panels, each in the coordinates of its own."""
        return tuple(shape for panel in self.panels for shape in panel.shapes)


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


def pad_with_crosses(pad: Pad) -> list[Shape]:
    """A pad with its crosses, whose world coordinates stand in cm along two edges.

    The crosses are those of `pads.pdf`, so they stay in place from picture to picture and lie where
    the printed ones lie.
    """
    gap = pad.cross_spacing_m / 5
    shapes: list[Shape] = [Box(pad.low_m, pad.high_m, fill=PAD, edge=PAD_EDGE)]
    crosses = pad.crosses_m()
    shapes += [Cross(at, gap) for at in crosses]
    for x in sorted({x for x, _ in crosses}):
        shapes.append(Text((x, pad.low_m[1] - gap), _cm(x), 8, FAINT))
    for y in sorted({y for _, y in crosses}):
        shapes.append(Text((pad.low_m[0] - gap / 2, y), _cm(y), 8, FAINT, align="right"))
    shapes.append(Text((pad.low_m[0], pad.high_m[1] + gap), "cm", 8, FAINT, align="left"))
    return shapes


def display_color(color_rgb: Sequence[float]) -> Color:
    """The colour of an object as displays take it.

    Args:
        color_rgb: Linear RGB in [0, 1], as in `ObjectSpec`.

    Source: IEC 61966-2-1, the sRGB transfer function.
    """
    linear = np.clip(np.asarray(color_rgb, dtype=np.float64), 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return "#" + "".join(f"{round(255 * float(channel)):02x}" for channel in encoded)


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
    """The picture to reset a scene by, where one view from above says everything."""
    return reset_page(scene, (from_above(shapes, observer, low_m, high_m),), notes)


def reset_page(scene: SceneSpec, panels: Sequence[Panel], notes: tuple[str, ...]) -> Drawing:
    """Frame views as the picture to reset a scene by: with its number and its sentence."""
    return Drawing(
        title=f"Episode {int(scene.scene_id)}",
        notes=(scene.task, scene.variant, *notes),
        sentence=scene.instruction.text,
        panels=tuple(panels),
    )


def from_above(
    shapes: Sequence[Shape], observer: Observer, low_m: Point, high_m: Point
) -> Panel:  # fmt: skip
    """The table between two corners, with +y up and the robot below.

    Its sides carry the words that instructions use, so that picture and sentence never disagree.
    """
    return Panel(
        low_m=(low_m[0] - BORDER_M, low_m[1] - BORDER_M),
        high_m=(high_m[0] + BORDER_M, high_m[1] + BORDER_M),
        shapes=tuple(shapes),
        sides=Sides(
            top=_spoken(observer, (0, 1)),
            bottom=f"{_spoken(observer, (0, -1))}  ·  the robot, and you, stand here",
            left=_spoken(observer, (-1, 0)),
            right=_spoken(observer, (1, 0)),
            robot=True,
        ),
    )


def from_front(
    shapes: Sequence[Shape], low_m: Point, high_m: Point, sides: Sides = Sides(top="from the front")
) -> Panel:
    """A standing thing, seen by somebody in front of it: z runs up, across as the task decides."""
    return Panel(
        low_m=(low_m[0] - BORDER_M, low_m[1] - BORDER_M),
        high_m=(high_m[0] + BORDER_M, high_m[1] + BORDER_M),
        shapes=tuple(shapes),
        sides=sides,
        view="front",
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
