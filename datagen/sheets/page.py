"""A page: few kinds of marks at absolute places in points, which every file format can write.

A point is 1/72 inch. The origin is the page's lower left corner, x runs right and y up.
"""

from __future__ import annotations

import functools
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

Point = tuple[float, float]
"""Points from the left and from the bottom of the page."""

POINTS_PER_M = 72 / 0.0254
POINTS_PER_MM = POINTS_PER_M / 1000
CAP_HEIGHT = 0.729
"""Height of capitals in units of the size of DejaVu Sans; words are centred by it."""


@dataclass(frozen=True, slots=True)
class Outline:
    """Straight strokes from point to point, and the area that they enclose."""

    points: tuple[Point, ...]
    closed: bool = False
    fill: str | None = None
    """`#rrggbb`; None leaves the area empty."""
    stroke: str | None = None
    width: float = 1.0


@dataclass(frozen=True, slots=True)
class Round:
    """A circle."""

    center: Point
    radius: float
    fill: str | None = None
    stroke: str | None = None
    width: float = 1.0
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Words:
    """A line of DejaVu Sans whose capitals' middle height stands at `at`."""

    at: Point
    text: str
    size: float
    color: str
    bold: bool = False
    align: Literal["left", "center", "right"] = "center"
    rotation_rad: float = 0.0

    @property
    def width(self) -> float:
        """Length of the line, points."""
        return text_width(self.text, self.size, self.bold)


Mark = Outline | Round | Words


@dataclass(frozen=True, slots=True)
class Page:
    """Marks in the order they are painted, on white."""

    width: float
    height: float
    marks: tuple[Mark, ...]


def box(
    low: Point,
    high: Point,
    fill: str | None = None,
    stroke: str | None = None,
    width: float = 1.0,
) -> Outline:
    """A rectangle along the page."""
    corners = (low, (high[0], low[1]), high, (low[0], high[1]))
    return Outline(corners, True, fill, stroke, width)


def line(start: Point, end: Point, color: str, width: float = 1.0) -> Outline:
    """One straight stroke."""
    return Outline((start, end), stroke=color, width=width)


@functools.cache
def font_path(bold: bool) -> Path:
    """DejaVu Sans as it ships with matplotlib, so that pictures are alike on every machine."""
    # Found without importing matplotlib, which takes longer than drawing ten pictures.
    spec = importlib.util.find_spec("matplotlib")
    assert spec is not None and spec.origin is not None
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf" / name


@functools.lru_cache(maxsize=8192)
def text_width(text: str, size: float, bold: bool) -> float:
    """Length of a line of words in the unit of `size`."""
    return _font_of_1000(bold).getlength(text) * size / 1000


@functools.cache
def _font_of_1000(bold: bool) -> FreeTypeFont:
    from PIL import ImageFont

    # The basic engine, so that widths do not depend on whether libraqm is there.
    return ImageFont.truetype(font_path(bold), 1000, layout_engine=ImageFont.Layout.BASIC)
