"""PDF of pages, with reportlab: vectors, embedded fonts, no dates."""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from codediffuser.datagen.sheets.page import CAP_HEIGHT, Outline, Page, Round, Words, font_path

if TYPE_CHECKING:
    from reportlab.lib.colors import Color
    from reportlab.pdfgen.canvas import Canvas

FONTS = {False: "DejaVuSans", True: "DejaVuSans-Bold"}


@dataclass(frozen=True, slots=True)
class Placed:
    """A page that is set on a sheet, smaller or as it is."""

    page: Page
    x: float
    y: float
    """Where its lower left corner comes to stand, points."""
    scale: float = 1.0
    clip: tuple[float, float, float, float] | None = None
    """Left, bottom, right and top of the part of the sheet that may show it, points."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One sheet of paper."""

    width: float
    height: float
    contents: tuple[Placed, ...]


def pdf_bytes(sheets: Iterable[Sheet], title: str) -> bytes:
    """Write sheets as one document; the same sheets give the same bytes.

    Viewers are told not to scale when printing, since a pad must come out at its true size.
    """
    from reportlab.pdfbase import pdfmetrics
    from reportlab.pdfbase.ttfonts import TTFont
    from reportlab.pdfgen.canvas import Canvas

    for bold, name in FONTS.items():
        # Anew for every document: a registered font remembers what earlier documents used of it.
        pdfmetrics.registerFont(TTFont(name, str(font_path(bold))))
    stream = io.BytesIO()
    canvas = Canvas(stream, invariant=1, pageCompression=1)
    canvas.setTitle(title)
    canvas.setCreator("codediffuser")
    canvas.setViewerPreference("PrintScaling", "None")
    for sheet in sheets:
        canvas.setPageSize((sheet.width, sheet.height))
        for placed in sheet.contents:
            canvas.saveState()
            if placed.clip is not None:
                left, bottom, right, top = placed.clip
                window = canvas.beginPath()
                window.rect(left, bottom, right - left, top - bottom)
                canvas.clipPath(window, stroke=0, fill=0)
            canvas.translate(placed.x, placed.y)
            canvas.scale(placed.scale, placed.scale)
            for mark in placed.page.marks:
                _paint(canvas, mark)
            canvas.restoreState()
        canvas.showPage()
    canvas.save()
    return stream.getvalue()


def _paint(canvas: Canvas, mark: Outline | Round | Words) -> None:
    if isinstance(mark, Words):
        _write(canvas, mark)
        return
    if mark.fill is not None:
        canvas.setFillColor(_color(mark.fill))
    if mark.stroke is not None:
        canvas.setStrokeColor(_color(mark.stroke))
        canvas.setLineWidth(mark.width)
    fill, stroke = int(mark.fill is not None), int(mark.stroke is not None)
    if isinstance(mark, Round):
        canvas.setDash(*((5, 3.5) if mark.dashed else ()))
        canvas.circle(*mark.center, mark.radius, stroke=stroke, fill=fill)
        canvas.setDash()
        return
    path = canvas.beginPath()
    path.moveTo(*mark.points[0])
    for point in mark.points[1:]:
        path.lineTo(*point)
    if mark.closed:
        path.close()
    canvas.drawPath(path, stroke=stroke, fill=fill)


def _write(canvas: Canvas, mark: Words) -> None:
    canvas.saveState()
    canvas.setFillColor(_color(mark.color))
    canvas.setFont(FONTS[mark.bold], mark.size)
    canvas.translate(*mark.at)
    if mark.rotation_rad:
        canvas.rotate(math.degrees(mark.rotation_rad))
    drop = -mark.size * CAP_HEIGHT / 2
    match mark.align:
        case "left":
            canvas.drawString(0, drop, mark.text)
        case "center":
            canvas.drawCentredString(0, drop, mark.text)
        case "right":
            canvas.drawRightString(0, drop, mark.text)
    canvas.restoreState()


@functools.cache
def _color(color: str) -> Color:
    """Parsed once: reportlab's own reading of `#rrggbb` takes longer than writing a mark."""
    from reportlab.lib.colors import HexColor

    return HexColor(color)
