"""What is printed on a book: its title down the spine, and the edges of its pages on top."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.scene import Vector3
from codediffuser.datagen.task import Decal
from codediffuser.schema import Strict

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

LIFT_M = 0.0004
"""How far the print lies above the body, so that it is always seen."""
PAGES_RGB = (232, 224, 205)
COVER_M = 0.002
"""Thickness of the covers around the pages."""
DARK, LIGHT = (20, 20, 22), (250, 250, 246)
LUMINANCE = (0.2126, 0.7152, 0.0722)
PAGE_COLUMNS = 8
"""Half the width, in pixels, of the strip of a picture that has the colour of pages."""


class TitleStyle(Strict):
    """How titles are printed."""

    pixels_per_m: float
    margin_m: float
    """Kept free at both ends of the spine."""
    width_share: float
    """Largest height of the letters as a share of the spine's width."""


def book_decal(
    title: str, color_rgb: Vector3, size_m: Vector3, bevel_m: tuple[float, float], style: TitleStyle
) -> Decal:
    """The print of one book of size (thickness, depth, height), in the book's frame."""
    import trimesh

    thickness, depth, height = size_m
    image = spine_image(title, color_rgb, thickness, height, style)
    half_x, half_y, out = thickness / 2, depth / 2, LIFT_M
    across, along = bevel_m
    # The spine from left to right: bevel, flat, bevel.
    profile = [
        (-half_x - out, -half_y + along - out), (-half_x + across - out, -half_y - out),
        (half_x - across + out, -half_y - out), (half_x + out, -half_y + along - out),
    ]  # fmt: skip
    vertices = [(x, y, z) for x, y in profile for z in (height, 0.0)]
    # The last columns of the picture are the colour of pages.
    spine_u = 1 - 2 * PAGE_COLUMNS / image.shape[1]
    shares = (np.array([x for x, _ in profile]) + half_x) / thickness
    uv = [(float(np.clip(s, 0, 1)) * spine_u, v) for s in shares for v in (0.0, 1.0)]
    faces = [f for i in (0, 2, 4) for f in ((i, i + 1, i + 3), (i, i + 3, i + 2))]
    x, front, back = half_x - COVER_M, -half_y + along, half_y - COVER_M
    pages = [(-x, front), (x, front), (half_x - across, back), (-half_x + across, back)]
    first = len(vertices)
    vertices += [(px, py, height + out) for px, py in pages]
    uv += [(1 - 0.5 * PAGE_COLUMNS / image.shape[1], 0.5)] * 4
    faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    mesh = trimesh.Trimesh(np.array(vertices), np.array(faces), process=False)
    return Decal(mesh, np.array(uv, dtype=np.float32), image)


def spine_image(
    title: str, color_rgb: Vector3, thickness_m: float, height_m: float, style: TitleStyle
) -> np.ndarray:
    """Picture (H, W, 3) uint8, sRGB, of a spine with its title running down, and of pages.

    The title is as large as fits. The rightmost columns have the colour of pages.
    """
    from PIL import Image, ImageDraw

    width = round(thickness_m * style.pixels_per_m)
    length = round(height_m * style.pixels_per_m)
    cover = _srgb(color_rgb)
    # Drawn lying, and then turned by a quarter: titles run from the top down.
    lying = Image.new("RGB", (length, width), cover)
    draw = ImageDraw.Draw(lying)
    room = length - 2 * round(style.margin_m * style.pixels_per_m)
    font = _fitting_font(title, room, round(style.width_share * width))
    draw.text((length / 2, width / 2), title, fill=ink_rgb(color_rgb), font=font, anchor="mm")
    spine = np.asarray(lying.transpose(Image.Transpose.ROTATE_270))
    pages = np.full((length, 2 * PAGE_COLUMNS, 3), PAGES_RGB, dtype=np.uint8)
    return np.concatenate([spine, pages], axis=1)


def ink_rgb(color_rgb: Vector3) -> tuple[int, int, int]:
    """Colour of print, sRGB, that stands out from a cover of a linear colour."""
    return DARK if float(np.dot(color_rgb, LUMINANCE)) > 0.25 else LIGHT


def _fitting_font(title: str, room_px: int, height_px: int) -> FreeTypeFont:
    """The largest font in which a title is neither longer than the room nor higher than allowed."""
    for size in range(2 * height_px, 6, -1):
        font = _font(size)
        left, top, right, bottom = font.getbbox(title or "x")
        if right - left <= room_px and bottom - top <= height_px:
            return font
    return _font(6)


@functools.cache
def _font(size_px: int) -> FreeTypeFont:
    import matplotlib
    from PIL import ImageFont

    # The basic layout engine needs no further library, so pixels are alike on every machine.
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans-Bold.ttf"
    return ImageFont.truetype(path, size_px, layout_engine=ImageFont.Layout.BASIC)


def _srgb(color_rgb: Vector3) -> tuple[int, int, int]:
    from codediffuser.datagen.drawing import display_color

    code = display_color(color_rgb)
    return (int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16))
