"""The picture by which an operator resets the scene, as PNG and SVG."""

from __future__ import annotations

from pathlib import Path

from codediffuser.datagen.drawing import Drawing
from codediffuser.datagen.sheets.layout import lay_out
from codediffuser.datagen.sheets.raster import png_bytes, render
from codediffuser.datagen.sheets.svg import svg_bytes
from codediffuser.files import write_bytes

DPI = 140


def render_png(drawing: Drawing) -> bytes:
    """Paint a drawing; the same drawing gives the same bytes with the same Pillow."""
    return png_bytes(render(lay_out(drawing), DPI))


def save_pictures(drawing: Drawing, png_path: Path) -> None:
    """Write the SVG and, last, the PNG beside it; each whole or not at all."""
    page = lay_out(drawing)
    write_bytes(png_path.with_suffix(".svg"), svg_bytes(page))
    write_bytes(png_path, png_bytes(render(page, DPI)))
