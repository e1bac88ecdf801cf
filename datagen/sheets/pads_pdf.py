"""`pads.pdf`: the pads of a task at their true size, over as many sheets of paper as it takes.

Each sheet of paper shows one tile. Neighbouring tiles show a common strip; cut marks in its middle
tell where to cut so that tiles lie edge to edge.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from codediffuser.datagen.drawing import FAINT, INK, PAD_EDGE
from codediffuser.datagen.sheets.layout import cross_marks
from codediffuser.datagen.sheets.page import (
    POINTS_PER_M,
    POINTS_PER_MM,
    Mark,
    Outline,
    Page,
    Point,
    Words,
    box,
    line,
)
from codediffuser.datagen.sheets.pdf import Placed, Sheet, pdf_bytes
from codediffuser.datagen.sheets.tags import PadSheet, Tag, pad_sheets, tag_modules
from codediffuser.datagen.task import Task

Paper = Literal["A4", "A3"]
PAPERS_MM: dict[Paper, tuple[float, float]] = {"A4": (210, 297), "A3": (297, 420)}

MARGIN_MM = 10.0
"""What printers leave white."""
FOOTER_MM = 20.0
"""Strip under the tile, for ruler, page map and words."""
OVERLAP_MM = 10.0
"""Width of the strip that neighbouring tiles share."""
CUT_MARK_MM = 6.0
RULER_MM = 100
BLACK = "#000000"
"""Tags and crosses are found by contrast."""


@dataclass(frozen=True, slots=True)
class Tiling:
    """How a sheet is divided along one side of the paper. All lengths in mm."""

    count: int
    step: float
    """From the start of one tile to that of the next. All tiles are alike, so that no cut comes
    near the tags at the ends."""
    length: float
    """Of the sheet."""

    @property
    def window(self) -> float:
        """Length of one tile with the strips that it shares."""
        return self.step + OVERLAP_MM if self.count > 1 else self.length

    def extent(self, index: int) -> tuple[float, float]:
        """Where a tile begins and ends, from the sheet's low edge."""
        return index * self.step, index * self.step + self.window

    def cuts(self, index: int) -> tuple[float, float]:
        """Where a tile is cut: at the sheet's edge, or in the middle of a shared strip."""
        start, end = self.extent(index)
        low = start + OVERLAP_MM / 2 if index > 0 else start
        return low, end - OVERLAP_MM / 2 if index < self.count - 1 else end


def pads_pdf(task: Task, variant: str, paper: Paper = "A4") -> bytes:
    """All pads of a variant at 1:1; the same pads give the same bytes.

    Raises:
        ConfigError: `variant` is unknown.
    """
    sheets: list[Sheet] = []
    for sheet in pad_sheets(task.name, variant, task.pads(variant)):
        sheets += _tiles(sheet, paper)
    return pdf_bytes(sheets, f"{task.name} {variant} pads")


def pad_page(sheet: PadSheet) -> Page:
    """The whole sheet on one page of its true size: pad, crosses, tags and their names."""
    width, height = (float(v) * POINTS_PER_M for v in np.subtract(sheet.high_m, sheet.low_m))

    def to_page(at_m: tuple[float, float]) -> Point:
        return (
            (at_m[0] - sheet.low_m[0]) * POINTS_PER_M,
            (at_m[1] - sheet.low_m[1]) * POINTS_PER_M,
        )

    pad = sheet.pad
    marks: list[Mark] = [
        box((0, 0), (width, height), stroke=FAINT, width=0.5),
        box(to_page(pad.low_m), to_page(pad.high_m), stroke=PAD_EDGE, width=1.0),
    ]
    crosses = pad.crosses_m()
    for at in crosses:
        marks += cross_marks(to_page(at), 8 * POINTS_PER_MM, BLACK, width=0.8)
    left, front = to_page(pad.low_m)
    for x in sorted({x for x, _ in crosses}):
        marks.append(Words((to_page((x, 0))[0], front - 8), _cm(x), 7, FAINT))
    for y in sorted({y for _, y in crosses}):
        at = (left - 2 * POINTS_PER_MM, to_page((0, y))[1])
        marks.append(Words(at, _cm(y), 7, FAINT, align="right"))
    for tag in sheet.tags:
        marks.append(tag_mark(tag, to_page(tag.low_m)))
    side = f"{sheet.title}  ·  cm  ·  this edge toward the robot"
    marks.append(Words((left, 8), side, 7, INK, bold=True, align="left"))
    return Page(width, height, tuple(marks))


def tag_mark(tag: Tag, corner: Point) -> Outline:
    """A tag as one outline around its black squares, which leaves no hairlines between them.

    Args:
        tag: What to draw.
        corner: Where its front left corner comes to stand on the page.
    """
    modules = tag_modules(tag.number)
    side = tag.size_m * POINTS_PER_M / len(modules)
    points: list[Point] = []
    # One stroke of the pen that visits every run of black and returns along the left edge.
    for row, blacks in enumerate(modules):
        top = corner[1] + (len(modules) - row) * side
        for start, end in _runs(blacks):
            left, right = corner[0] + start * side, corner[0] + end * side
            points += [(corner[0], top), (left, top), (right, top)]
            points += [(right, top - side), (left, top - side), (left, top), (corner[0], top)]
    points.append((corner[0], corner[1]))
    return Outline(tuple(points), closed=True, fill=BLACK)


def _runs(blacks: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and one past last column of every run of black."""
    column = 0
    for black, run in itertools.groupby(blacks.tolist()):
        length = len(list(run))
        if black:
            yield column, column + length
        column += length


def _tiles(sheet: PadSheet, paper: Paper) -> list[Sheet]:
    """The sheets of paper for one pad, row by row from the front left."""
    short, long = PAPERS_MM[paper]
    page = pad_page(sheet)
    size = (page.width / POINTS_PER_MM, page.height / POINTS_PER_MM)
    upright, lying = (divide(size, paper_mm) for paper_mm in ((short, long), (long, short)))
    fewer = upright[0].count * upright[1].count <= lying[0].count * lying[1].count
    paper_mm, tilings = ((short, long), upright) if fewer else ((long, short), lying)
    across, up = tilings
    return [
        _tile(page, sheet.title, paper_mm, (across, up), (column, row))
        for row in range(up.count)
        for column in range(across.count)
    ]


def divide(
    size_mm: tuple[float, float], paper_mm: tuple[float, float]
) -> tuple[Tiling, Tiling]:  # fmt: skip
    """How a sheet of a size is divided on a paper, across and up."""
    windows = (paper_mm[0] - 2 * MARGIN_MM, paper_mm[1] - 2 * MARGIN_MM - FOOTER_MM)
    tilings = []
    for length, window in zip(size_mm, windows, strict=True):
        count = max(1, int(np.ceil((length - OVERLAP_MM) / (window - OVERLAP_MM) - 1e-9)))
        tilings.append(Tiling(count, (length - OVERLAP_MM) / count, length))
    return tilings[0], tilings[1]


def _tile(
    page: Page, title: str, paper_mm: tuple[float, float],
    tilings: tuple[Tiling, Tiling], index: tuple[int, int],
) -> Sheet:  # fmt: skip
    """One sheet of paper: its window on the page, and ruler, map and cut marks around it."""
    extents = [tiling.extent(i) for tiling, i in zip(tilings, index, strict=True)]
    origin_mm = (MARGIN_MM - extents[0][0], MARGIN_MM + FOOTER_MM - extents[1][0])
    low = [o + e[0] for o, e in zip(origin_mm, extents, strict=True)]
    high = [o + e[1] for o, e in zip(origin_mm, extents, strict=True)]
    window = tuple(v * POINTS_PER_MM for v in (*low, *high))
    marks = [
        *_cut_marks(tilings, index, origin_mm, (low, high)),
        *_ruler(),
        *_caption(title, tilings, index, paper_mm),
    ]
    width, height = (v * POINTS_PER_MM for v in paper_mm)
    x, y = (v * POINTS_PER_MM for v in origin_mm)
    clip = (window[0], window[1], window[2], window[3])
    around = Placed(Page(width, height, tuple(marks)), 0, 0)
    return Sheet(width, height, (Placed(page, x, y, clip=clip), around))


def _cut_marks(
    tilings: tuple[Tiling, Tiling], index: tuple[int, int], origin_mm: tuple[float, float],
    window_mm: tuple[list[float], list[float]],
) -> Iterator[Mark]:  # fmt: skip
    """Short strokes outside the window at both ends of every line to cut along."""
    (left, front), (right, back) = window_mm
    gap = 1.0
    for x in (origin_mm[0] + cut for cut in tilings[0].cuts(index[0])):
        yield _line_mm((x, front - gap), (x, front - CUT_MARK_MM))
        yield _line_mm((x, back + gap), (x, back + CUT_MARK_MM))
    for y in (origin_mm[1] + cut for cut in tilings[1].cuts(index[1])):
        yield _line_mm((left - gap, y), (left - CUT_MARK_MM, y))
        yield _line_mm((right + gap, y), (right + CUT_MARK_MM, y))


def _ruler() -> Iterator[Mark]:
    """A line of 100 mm to hold a ruler to, since printers like to scale."""
    x, y = MARGIN_MM, MARGIN_MM + 3
    yield _line_mm((x, y), (x + RULER_MM, y))
    for mm in range(0, RULER_MM + 1, 5):
        yield _line_mm((x + mm, y), (x + mm, y + (3 if mm % 10 == 0 else 1.5)))
    words = "0 to 100 mm: measure it. Print at 100 %, without “fit to page”."
    yield _words_mm((x, MARGIN_MM), words, 7)


def _caption(
    title: str, tilings: tuple[Tiling, Tiling], index: tuple[int, int],
    paper_mm: tuple[float, float],
) -> Iterator[Mark]:  # fmt: skip
    """Which tile this is, in words and on a small map of all tiles."""
    (columns, rows), (column, row) = (t.count for t in tilings), index
    number, total = row * columns + column + 1, rows * columns
    x = MARGIN_MM + RULER_MM + 8
    yield _words_mm((x, MARGIN_MM + 4), title, 8, bold=True)
    where = f"page {number} of {total}"
    if total == 1:
        yield _words_mm((x, MARGIN_MM), where, 7)
        return
    where += f", column {column + 1} of {columns}, row {row + 1} of {rows} from the robot"
    yield _words_mm((x, MARGIN_MM), where, 7)
    cell = min(5.0, 9.0 / rows)
    right = paper_mm[0] - MARGIN_MM
    for j, i in itertools.product(range(rows), range(columns)):
        low = (right - (columns - i) * cell, MARGIN_MM + 3 + j * cell)
        corners = [v * POINTS_PER_MM for v in (*low, low[0] + cell, low[1] + cell)]
        fill = INK if (i, j) == index else None
        yield box((corners[0], corners[1]), (corners[2], corners[3]), fill, FAINT, 0.5)


def _line_mm(start: Point, end: Point) -> Outline:
    a, b = ((at[0] * POINTS_PER_MM, at[1] * POINTS_PER_MM) for at in (start, end))
    return line(a, b, INK, 0.5)


def _words_mm(at: Point, text: str, size: float, bold: bool = False) -> Words:
    place = (at[0] * POINTS_PER_MM, at[1] * POINTS_PER_MM)
    return Words(place, text, size, INK, bold, "left")


def _cm(value_m: float) -> str:
    return f"{100 * value_m:+.4g}" if abs(value_m) > 1e-9 else "0"
