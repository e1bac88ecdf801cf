"""From a `Drawing` in metres to a `Page` in points: where panels, words and marks go."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.drawing import (
    FAINT,
    INK,
    Arrow,
    Box,
    Cross,
    Disc,
    Drawing,
    Line,
    Panel,
    Polygon,
    Shape,
    Sides,
    Text,
)
from codediffuser.datagen.sheets.page import (
    Mark,
    Outline,
    Page,
    Point,
    Round,
    Words,
    box,
    line,
    text_width,
)

NARROW, WIDE = 432.0, 792.0
"""Width of a page with one panel, and with several."""
MARGIN = 30.0
"""Around every panel; the words of its sides stand there."""
TITLE_HEIGHT, LINE_HEIGHT = 37.0, 16.0
FRAME = "#d4d8dd"
BAR_PADDING = 4.5
ARROW_HEAD, ARROW_BEND = 9.0, 0.15

ToPage = Callable[[Point], Point]


@dataclass(frozen=True, slots=True)
class PlacedPanel:
    """A panel with its place on a page."""

    panel: Panel
    corner: Point
    """Where its lower left corner stands."""
    scale: float
    """Points per metre."""

    @property
    def far_corner(self) -> Point:
        """Where its upper right corner stands."""
        return self.to_page(self.panel.high_m)

    def to_page(self, at_m: Point) -> Point:
        """From metres in the panel to points on the page."""
        low = self.panel.low_m
        return (
            self.corner[0] + self.scale * (at_m[0] - low[0]),
            self.corner[1] + self.scale * (at_m[1] - low[1]),
        )

    def marks(self) -> Iterator[Mark]:
        """Frame, shapes and the words at the sides."""
        yield box(self.corner, self.far_corner, stroke=FRAME, width=0.8)
        for shape in self.panel.shapes:
            yield from shape_marks(shape, self.to_page, self.scale)
        yield from _side_marks(self.panel.sides, self.corner, self.far_corner)


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything of a drawing goes."""

    width: float
    height: float
    lines: tuple[str, ...]
    """The sentence, broken."""
    panels: tuple[PlacedPanel, ...]


def lay_out(drawing: Drawing) -> Page:
    """Set a drawing on a page of fixed width: title, sentence, and its panels at one scale."""
    layout = place_panels(drawing)
    marks = list(_header(drawing, layout))
    for placed in layout.panels:
        marks += placed.marks()
    return Page(layout.width, layout.height, tuple(marks))


def place_panels(drawing: Drawing) -> Layout:
    """Divide the page: panels side by side at one scale, the lower ones in the middle."""
    width = NARROW if len(drawing.panels) == 1 else WIDE
    lines = wrap(drawing.sentence, 10.5, width - 2 * MARGIN)
    spans = [np.subtract(panel.high_m, panel.low_m) for panel in drawing.panels]
    scale = (width - 2 * MARGIN * len(spans)) / sum(float(span[0]) for span in spans)
    tallest = scale * max(float(span[1]) for span in spans)
    height = TITLE_HEIGHT + LINE_HEIGHT * len(lines) + tallest + 2 * MARGIN
    placed = []
    left, middle = MARGIN, MARGIN + tallest / 2
    for panel, span in zip(drawing.panels, spans, strict=True):
        corner = (left, middle - scale * float(span[1]) / 2)
        placed.append(PlacedPanel(panel, corner, scale))
        left += scale * float(span[0]) + 2 * MARGIN
    return Layout(width, height, tuple(lines), tuple(placed))


def shape_marks(shape: Shape, to_page: ToPage, scale: float) -> list[Mark]:
    """The marks of one shape.

    Args:
        shape: In metres.
        to_page: From metres to the page.
        scale: Points per metre, for lengths.
    """
    match shape:
        case Disc():
            center, radius = to_page(shape.center_m), shape.radius_m * scale
            return [Round(center, radius, shape.fill, shape.edge, 1.6, shape.dashed)]
        case Box():
            return [box(to_page(shape.low_m), to_page(shape.high_m), shape.fill, shape.edge)]
        case Line():
            start, end = to_page(shape.start_m), to_page(shape.end_m)
            return [line(start, end, shape.color, shape.width_pt)]
        case Polygon():
            corners = tuple(to_page(at) for at in shape.corners_m)
            return [Outline(corners, True, shape.fill, shape.edge, shape.width_pt)]
        case Cross():
            return cross_marks(to_page(shape.center_m), shape.size_m * scale, shape.color)
        case Arrow():
            return _arrow(to_page(shape.start_m), to_page(shape.end_m), shape.color)
        case Text():
            size = shape.size_pt
            if shape.fit_m is not None:
                longest = text_width(shape.text, size, shape.bold)
                size *= min(1.0, shape.fit_m * scale / max(longest, 1e-9))
            words = Words(
                to_page(shape.at_m), shape.text, size, shape.color, shape.bold, shape.align,
                shape.rotation_rad,
            )  # fmt: skip
            return [words]


def cross_marks(center: Point, size: float, color: str, width: float = 1.1) -> list[Mark]:
    """Two strokes that meet in their middles."""
    (x, y), half = center, size / 2
    return [
        line((x - half, y), (x + half, y), color, width),
        line((x, y - half), (x, y + half), color, width),
    ]


def wrap(text: str, size: float, width: float, bold: bool = False) -> list[str]:
    """Break a sentence into lines no longer than `width`; a longer single word stays whole."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(longer, size, bold) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _header(drawing: Drawing, layout: Layout) -> Iterator[Mark]:
    top, width = layout.height - 22, layout.width
    yield Words((MARGIN, top), drawing.title, 15, INK, bold=True, align="left")
    notes = "  ·  ".join(drawing.notes)
    free = width - 2 * MARGIN - text_width(drawing.title, 15, True) - 12
    size = 8.5 * min(1.0, free / max(text_width(notes, 8.5, False), 1e-9))
    yield Words((width - MARGIN, top), notes, size, FAINT, align="right")
    for i, words in enumerate(layout.lines):
        at = (MARGIN, layout.height - 43 - LINE_HEIGHT * i)
        yield Words(at, words, 10.5, INK, align="left")


def _side_marks(sides: Sides, low: Point, high: Point) -> Iterator[Mark]:
    (x, y), edge = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2), MARGIN / 2
    style = {"size": 9.0, "color": INK, "bold": True}
    if sides.robot:
        # A dark bar stands for the robot: nobody should turn the page the wrong way round.
        half_x = text_width(sides.bottom, 9, True) / 2 + 2 * BAR_PADDING
        half_y = 4.5 + BAR_PADDING
        bottom = low[1] - edge
        yield box((x - half_x, bottom - half_y), (x + half_x, bottom + half_y), fill=INK)
        style = {**style, "color": "#ffffff"}
    places = (
        (sides.bottom, (x, low[1] - edge), 0.0, style["color"]),
        (sides.top, (x, high[1] + edge / 2), 0.0, INK),
        (sides.left, (low[0] - edge, y), math.pi / 2, INK),
        (sides.right, (high[0] + edge, y), -math.pi / 2, INK),
    )
    for words, at, turn, color in places:
        if words:
            yield Words(at, words, 9, str(color), bold=True, rotation_rad=turn)


def _arrow(start: Point, end: Point, color: str) -> list[Mark]:
    """A gently bent stroke with a filled head whose tip is `end`."""
    a, b = np.array(start), np.array(end)
    along = b - a
    control = (a + b) / 2 + ARROW_BEND * np.array([along[1], -along[0]])
    t = np.linspace(0, 1, 17)[:, None]
    curve = (1 - t) ** 2 * a + 2 * t * (1 - t) * control + t**2 * b
    tip = b - control
    tip /= max(float(np.linalg.norm(tip)), 1e-9)
    base, side = b - tip * ARROW_HEAD, np.array([-tip[1], tip[0]]) * ARROW_HEAD * 0.4
    # The stroke ends inside the head, not at its sharp tip.
    shaft = [p for p in curve if (b - p) @ tip > ARROW_HEAD * 0.7] + [base]
    return [
        Outline(tuple((float(x), float(y)) for x, y in shaft), stroke=color, width=1.6),
        Outline(
            tuple((float(x), float(y)) for x, y in (b, base + side, base - side)), True, fill=color
        ),
    ]
