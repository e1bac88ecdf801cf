"""`sheet.pdf`: the reset pictures of a set, several to a page of A4."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from codediffuser.datagen.drawing import FAINT, Drawing
from codediffuser.datagen.sheets.layout import lay_out
from codediffuser.datagen.sheets.page import POINTS_PER_MM, Page, Words
from codediffuser.datagen.sheets.pdf import Placed, Sheet, pdf_bytes

WIDTH, HEIGHT = 210 * POINTS_PER_MM, 297 * POINTS_PER_MM
MARGIN, FOOTER, GAP = 10 * POINTS_PER_MM, 6 * POINTS_PER_MM, 5 * POINTS_PER_MM
AT_LEAST = 6
"""Pictures on a full page; more where they fit without becoming smaller."""


def contact_sheet(drawings: Iterable[Drawing], title: str) -> bytes:
    """A PDF with every drawing in its order and a numbered foot on every page.

    Args:
        drawings: At least one.
        title: Stands in the foot and in the document's properties.
    """
    pages = [lay_out(drawing) for drawing in drawings]
    return pdf_bytes(_sheets(pages, title), title)


def _sheets(pages: list[Page], title: str) -> Iterator[Sheet]:
    columns, rows, scale = grid(max(p.width for p in pages), max(p.height for p in pages))
    per_sheet = columns * rows
    total = math.ceil(len(pages) / per_sheet)
    for number in range(total):
        contents = []
        for i, page in enumerate(pages[number * per_sheet : (number + 1) * per_sheet]):
            row, column = divmod(i, columns)
            x = MARGIN + column * (WIDTH - 2 * MARGIN + GAP) / columns
            top = HEIGHT - MARGIN - row * (HEIGHT - 2 * MARGIN - FOOTER + GAP) / rows
            contents.append(Placed(page, x, top - page.height * scale, scale))
        yield Sheet(WIDTH, HEIGHT, (*contents, Placed(_foot(title, number + 1, total), 0, 0)))


def grid(width: float, height: float) -> tuple[int, int, float]:
    """Columns, rows and the scale for pictures of a size: the largest that leaves `AT_LEAST`."""
    columns = 1
    while True:
        cell_width = (WIDTH - 2 * MARGIN - (columns - 1) * GAP) / columns
        scale = min(1.0, cell_width / width)
        free = HEIGHT - 2 * MARGIN - FOOTER
        rows = int((free + GAP) // (scale * height + GAP))
        if rows * columns >= AT_LEAST:
            return columns, rows, scale
        columns += 1


def _foot(title: str, number: int, total: int) -> Page:
    words = (
        Words((MARGIN, MARGIN), title, 8, FAINT, align="left"),
        Words((WIDTH - MARGIN, MARGIN), f"page {number} of {total}", 8, FAINT, align="right"),
    )
    return Page(WIDTH, HEIGHT, words)
