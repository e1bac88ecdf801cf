"""Frames of a rollout: views with attention tinted in and a caption; key-frame strip."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from codediffuser.errors import ShapeError
from codediffuser.poses import apply_transform, invert_transform

TILE_SIZE = (320, 240)
"""Width and height in pixels that every view is brought to."""

CAPTION_HEIGHT = 80
STRIP_TILES = (3, 2)
"""Columns and rows of the strip of key frames."""

ROLE_COLORS = ((255, 140, 0), (0, 200, 160))
"""Tint of the picked object's points and of the place's points."""

OCCLUSION_MARGIN_M = 0.01
_TINT = 0.6
_INK, _SOFT, _PAPER = (240, 240, 236), (160, 165, 170), (24, 27, 30)
_SUCCESS = (130, 225, 130)


@dataclass(frozen=True, slots=True)
class VideoView:
    """One camera's picture with what it takes to draw world points into it."""

    rgb: np.ndarray
    """(H, W, 3) uint8."""
    depth_m: np.ndarray
    """(H, W) float32, 0 where there is no reading."""
    K: np.ndarray
    """(3, 3) float64, pixels."""
    T_world_camera: np.ndarray
    """(4, 4) float64, OpenCV axes."""


@dataclass(frozen=True, slots=True)
class Caption:
    """Words beneath a frame."""

    instruction: str
    time_s: float
    phase: str
    attended: tuple[str, ...]
    """Names of the attended things, in the order of the roles."""
    success: bool


def tint_attention(view: VideoView, points_world: np.ndarray, attention: np.ndarray) -> np.ndarray:
    """Colour the pixels onto which attended points fall and where nothing hides them.

    Args:
        view: The picture.
        points_world: (N, 3) float32, metres.
        attention: (N, n_roles) in [0, 1]; a point counts for its strongest role above 0.5.

    Returns:
        rgb: (H, W, 3) uint8, a copy.
    """
    rgb = view.rgb.copy()
    height, width = rgb.shape[:2]
    points = apply_transform(invert_transform(view.T_world_camera), points_world)
    ahead = points[:, 2] > 1e-3
    points, attention = points[ahead], attention[ahead]
    pixels = points @ view.K.T.astype(points.dtype)
    u = np.rint(pixels[:, 0] / pixels[:, 2]).astype(np.int64)
    v = np.rint(pixels[:, 1] / pixels[:, 2]).astype(np.int64)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v, z, attention = u[inside], v[inside], points[inside, 2], attention[inside]
    seen = view.depth_m[v, u]
    visible = (seen <= 0) | (z <= seen + OCCLUSION_MARGIN_M)
    for role, color in enumerate(ROLE_COLORS[: attention.shape[1]]):
        strongest = attention.argmax(axis=1) == role
        # A point is drawn one pixel wider to each side, so that labelled points close to a patch.
        chosen = np.zeros((height + 2, width + 2), dtype=bool)
        mine = visible & strongest & (attention[:, role] > 0.5)
        for right, down in np.ndindex(3, 3):
            chosen[v[mine] + down, u[mine] + right] = True
        chosen = chosen[1:-1, 1:-1]
        rgb[chosen] = ((1 - _TINT) * rgb[chosen] + _TINT * np.array(color)).astype(np.uint8)
    return rgb


def compose_frame(pictures: Sequence[np.ndarray], caption: Caption) -> np.ndarray:
    """Put pictures side by side over a caption.

    Args:
        pictures: One or more (H, W, 3) uint8; each is brought to `TILE_SIZE`.
        caption: What is written beneath.

    Returns:
        frame: (240 + 80, 320 * n, 3) uint8.

    Raises:
        ShapeError: There is no picture.
    """
    if not pictures:
        raise ShapeError("compose_frame: expected at least one picture, got none")
    width, height = TILE_SIZE
    canvas = Image.new("RGB", (width * len(pictures), height + CAPTION_HEIGHT), _PAPER)
    for i, rgb in enumerate(pictures):
        tile = Image.fromarray(rgb)
        if tile.size != TILE_SIZE:
            tile = tile.resize(TILE_SIZE, Image.Resampling.BICUBIC)
        canvas.paste(tile, (width * i, 0))
    _write_caption(canvas, caption, top=height)
    return np.asarray(canvas)


def _write_caption(canvas: Image.Image, caption: Caption, top: int) -> None:
    draw = ImageDraw.Draw(canvas)
    # Two lines hold every shipped template; a longer sentence of a user is cut, not overprinted.
    lines = textwrap.wrap(caption.instruction, width=canvas.width // 7, max_lines=2)
    for i, line in enumerate(lines):
        draw.text((12, top + 8 + 19 * i), line, fill=_INK, font=_font(15))
    state = "   success" if caption.success else ""
    draw.text(
        (12, top + 54), f"{caption.time_s:4.1f} s   {caption.phase}{state}",
        fill=_SUCCESS if caption.success else _SOFT, font=_font(13),
    )  # fmt: skip
    right = canvas.width - 12.0
    for color, name in reversed(list(zip(ROLE_COLORS, caption.attended, strict=False))):
        right -= draw.textlength(name, font=_font(13))
        draw.text((right, top + 54), name, fill=color, font=_font(13))
        right -= 12


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def key_frame_strip(pictures: Sequence[np.ndarray], tile: tuple[int, int] = (160, 120)) -> bytes:
    """Lay evenly spaced pictures out in reading order, first and last included.

    Args:
        pictures: (H, W, 3) uint8 in order of time; fewer than the strip has tiles are repeated.
        tile: Width and height of one picture, pixels.

    Returns:
        JPEG bytes.

    Raises:
        ShapeError: There is no picture.
    """
    import io

    if not pictures:
        raise ShapeError("key_frame_strip: expected at least one picture, got none")
    columns, rows = STRIP_TILES
    chosen = np.linspace(0, len(pictures) - 1, columns * rows).round().astype(int)
    canvas = Image.new("RGB", (columns * tile[0], rows * tile[1]))
    for k, index in enumerate(chosen):
        picture = Image.fromarray(pictures[index]).resize(tile, Image.Resampling.BICUBIC)
        canvas.paste(picture, (k % columns * tile[0], k // columns * tile[1]))
    stream = io.BytesIO()
    canvas.save(stream, "JPEG", quality=82, optimize=True)
    return stream.getvalue()
