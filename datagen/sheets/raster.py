"""Pixels of a `Page`, with Pillow."""

from __future__ import annotations

import functools
import io
import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.sheets.page import (
    CAP_HEIGHT,
    Outline,
    Page,
    Point,
    Round,
    Words,
    font_path,
)

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFont import FreeTypeFont

SMOOTH = 4
"""Each mark is drawn this many times larger and averaged: its edges get 16 shades."""
DASH_DEGREES = 12


def render(page: Page, dpi: float) -> Image:
    """Paint a page on white; the same page gives the same pixels with the same Pillow."""
    from PIL import Image

    painter = Painter(
        Image.new("RGB", (pixels(page.width, dpi), pixels(page.height, dpi)), "white"),
        dpi / 72, page.height,
    )  # fmt: skip
    for mark in page.marks:
        painter.paint(mark)
    return painter.image


def png_bytes(image: Image, compress_level: int = 3) -> bytes:
    """Encode as PNG without any metadata."""
    stream = io.BytesIO()
    image.save(stream, "png", compress_level=compress_level)
    return stream.getvalue()


def pixels(length_pt: float, dpi: float) -> int:
    """Whole pixels that show a length."""
    return max(1, round(length_pt * dpi / 72))


class Painter:
    """Paints marks onto an image.

    Args:
        image: RGB; painted in place.
        scale: Pixels per point.
        height: Of the page in points; its upper edge is row 0.
    """

    def __init__(self, image: Image, scale: float, height: float) -> None:
        from PIL import ImageDraw

        self.image = image
        self.scale = scale
        self._height = height
        self._draw = ImageDraw.Draw(image)

    def paint(self, mark: Outline | Round | Words) -> None:
        """Paint one mark over what is there."""
        match mark:
            case Round():
                self._round(mark)
            case Words():
                self._words(mark)
            case Outline():
                points = self._to_pixels(mark.points)
                if mark.fill is not None:
                    self._fill(points, mark.fill)
                if mark.stroke is not None:
                    self._stroke(points, mark)

    def _to_pixels(self, points: Sequence[Point]) -> np.ndarray:
        """Page points to (N, 2) float64 columns and rows of pixel edges."""
        at = np.asarray(points, dtype=np.float64) * self.scale
        at[:, 1] = self._height * self.scale - at[:, 1]
        return at

    def _fill(self, corners: np.ndarray, color: str) -> None:
        if len(corners) == 4 and _along_axes(corners):
            self._rectangle(corners.min(axis=0), corners.max(axis=0), color)
            return
        from PIL import Image, ImageDraw

        low, size = _window(corners.min(axis=0), corners.max(axis=0))
        mask = Image.new("L", size)
        # Pillow fills up to and including the corners' pixels: half a fine pixel is taken off.
        at = (corners - low) * SMOOTH - 0.5
        ImageDraw.Draw(mask).polygon([(float(x), float(y)) for x, y in at], fill=255)
        self.image.paste(color, (int(low[0]), int(low[1])), mask.reduce(SMOOTH))

    def _stroke(self, points: np.ndarray, mark: Outline) -> None:
        """Every segment as a filled quadrangle, half a width longer where it meets the next."""
        assert mark.stroke is not None
        width = mark.width * self.scale
        ends = np.concatenate([points, points[:1]]) if mark.closed else points
        last = len(ends) - 2
        for i, (a, b) in enumerate(itertools.pairwise(ends)):
            length = float(np.linalg.norm(b - a))
            if length == 0:
                continue
            step = (b - a) / length * width / 2
            tail = step * (mark.closed or i > 0)
            head = step * (mark.closed or i < last)
            side = np.array([-step[1], step[0]])
            corners = [a - tail + side, b + head + side, b + head - side, a - tail - side]
            self._fill(np.array(corners), mark.stroke)

    def _rectangle(self, low: np.ndarray, high: np.ndarray, color: str) -> None:
        """A rectangle of whole pixels, at least one thick, so that thin lines stay crisp."""
        size = np.maximum(1, np.round(high - low)).astype(int)
        at = np.round((low + high - size) / 2).astype(int)
        far = at + size - 1
        self._draw.rectangle((*at.tolist(), *far.tolist()), fill=color)

    def _round(self, mark: Round) -> None:
        from PIL import Image, ImageDraw

        (center,), radius = self._to_pixels([mark.center]), mark.radius * self.scale
        half = mark.width * self.scale / 2 if mark.stroke is not None else 0.0
        low, size = _window(center - radius - half, center + radius + half)
        middle = (center - low) * SMOOTH

        def around(r: float) -> tuple[float, float, float, float]:
            r *= SMOOTH
            return (middle[0] - r, middle[1] - r, middle[0] + r - 1, middle[1] + r - 1)

        where = (int(low[0]), int(low[1]))
        if mark.fill is not None:
            mask = Image.new("L", size)
            ImageDraw.Draw(mask).ellipse(around(radius), fill=255)
            self.image.paste(mark.fill, where, mask.reduce(SMOOTH))
        if mark.stroke is not None:
            mask = Image.new("L", size)
            pen, width = ImageDraw.Draw(mask), max(1, round(2 * half * SMOOTH))
            if mark.dashed:
                for start in range(0, 360, 2 * DASH_DEGREES):
                    pen.arc(around(radius + half), start, start + DASH_DEGREES, 255, width)
            else:
                pen.ellipse(around(radius + half), outline=255, width=width)
            self.image.paste(mark.stroke, where, mask.reduce(SMOOTH))

    def _words(self, mark: Words) -> None:
        size = mark.size * self.scale
        font = _font(mark.bold, round(size * 64) / 64)
        # Hinted letters are a little wider or narrower than those of a vector page.
        width = font.getlength(mark.text)
        start = -width * {"left": 0.0, "center": 0.5, "right": 1.0}[mark.align]
        (at,) = self._to_pixels([mark.at])
        if mark.rotation_rad == 0:
            origin = (at[0] + start, at[1] + size * CAP_HEIGHT / 2)
            self._draw.text(origin, mark.text, fill=mark.color, font=font, anchor="ls")
            return
        from PIL import Image, ImageDraw

        # A square with the anchor point in its middle, large enough for any turn.
        half = math.ceil(max(-start, start + width) + size)
        whole = np.floor(at).astype(int)
        mask = Image.new("L", (2 * half, 2 * half))
        origin = (half + start, half + size * CAP_HEIGHT / 2)
        ImageDraw.Draw(mask).text(origin, mark.text, fill=255, font=font, anchor="ls")
        turned = mask.rotate(math.degrees(mark.rotation_rad), Image.Resampling.BICUBIC)
        window = turned.getbbox()
        if window is not None:
            where = (int(whole[0]) - half + window[0], int(whole[1]) - half + window[1])
            self.image.paste(mark.color, where, turned.crop(window))


def _along_axes(corners: np.ndarray) -> bool:
    """Whether a quadrangle is a rectangle along rows and columns."""
    steps = np.abs(np.roll(corners, -1, axis=0) - corners) > 1e-6
    return bool(np.all(steps[:, 0] != steps[:, 1]) and np.all(steps[0] != steps[1]))


def _window(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, tuple[int, int]]:
    """Whole pixels around a mark: the first one, and the size of the enlarged mask."""
    first = np.floor(low) - 1
    extent = (np.ceil(high) + 1 - first).astype(int) * SMOOTH
    return first, (int(extent[0]), int(extent[1]))


@functools.lru_cache(maxsize=256)
def _font(bold: bool, size: float) -> FreeTypeFont:
    from PIL import ImageFont

    return ImageFont.truetype(font_path(bold), size, layout_engine=ImageFont.Layout.BASIC)
