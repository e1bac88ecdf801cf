"""An episode for people: pictures over time and cameras, its motion as curves, a film.

Works on simulated episodes and on imported ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from codediffuser.datagen.episode import Episode, Frame
from codediffuser.datagen.motion_plot import save_motion_plot
from codediffuser.errors import EpisodeError
from codediffuser.files import atomic_path
from codediffuser.video import write_video

SHEET, MOTION, VIDEO = "sheet.png", "motion.png", "video.mp4"

TILE_WIDTH = 200
COLUMNS = 8
"""Moments of the contact sheet, first and last included."""

HEADER = 54
LABEL = 22
DEPTH_M = (0.2, 1.4)
"""Range of the depth colours; readings beyond take the last colour, none is black."""

_INK, _SOFT, _PAPER = (236, 236, 232), (150, 156, 162), (24, 27, 30)


def inspect_episode(folder: Path, out: Path) -> Iterator[Path]:
    """Write contact sheet, motion plot and film of an episode; yield each path once it is there.

    Args:
        folder: `RUN/episodes/<id>`.
        out: Folder; made when missing.

    Raises:
        EpisodeError: The episode is damaged, or has no pictures.
    """
    episode = Episode.open(folder)
    if not episode.manifest.cameras:
        raise EpisodeError(f"{folder}: has no cameras, so there is nothing to look at")
    with atomic_path(out / SHEET) as partial:
        contact_sheet(episode).save(partial)
    yield out / SHEET
    save_motion_plot(episode, out / MOTION)
    yield out / MOTION
    write_video(film_frames(episode), out / VIDEO, fps=episode.hz)
    yield out / VIDEO


def contact_sheet(episode: Episode, columns: int = COLUMNS) -> Image.Image:
    """Pictures of every camera, colour above depth, at evenly spaced moments."""
    moments = np.unique(np.linspace(0, episode.num_frames - 1, columns).round().astype(int))
    shots = [episode.frame(int(k)) for k in moments]
    rows = list(_rows(shots[0]))
    sizes = [_tile_size(picture) for _, picture in rows]
    top = HEADER + LABEL
    canvas = Image.new(
        "RGB", (TILE_WIDTH * len(shots), top + sum(h + LABEL for _, h in sizes)), _PAPER
    )
    draw = ImageDraw.Draw(canvas)
    _write_header(draw, episode)
    for column, shot in enumerate(shots):
        y = top
        draw.text((column * TILE_WIDTH + 6, HEADER), f"{shot.time_s:.2f} s", _SOFT, _font(14))
        for (name, picture), size in zip(_rows(shot), sizes, strict=True):
            canvas.paste(Image.fromarray(picture).resize(size), (column * TILE_WIDTH, y))
            if column == 0:
                draw.text((6, y + size[1] + 2), name, _SOFT, _font(14))
            y += size[1] + LABEL
    return canvas


def _rows(frame: Frame) -> Iterator[tuple[str, np.ndarray]]:
    """Name and picture (H, W, 3) uint8 of every row of the sheet."""
    for name, rgb in frame.rgb.items():
        yield name, rgb
        if name in frame.depth_m:
            low, high = DEPTH_M
            yield f"{name}, depth {low:g} (red) to {high:g} m", color_depth(frame.depth_m[name])


def color_depth(depth_m: np.ndarray) -> np.ndarray:
    """Depth (H, W) in metres as colours (H, W, 3) uint8: near is red, no reading black."""
    low, high = DEPTH_M
    near = 1.0 - np.clip((depth_m - low) / (high - low), 0, 1)
    bgr = cv2.applyColorMap((near * 255).astype(np.uint8), cv2.COLORMAP_TURBO)
    bgr[depth_m <= 0] = 0
    return np.ascontiguousarray(bgr[..., ::-1])


def film_frames(episode: Episode) -> Iterator[np.ndarray]:
    """All cameras side by side in a grid under the instruction, one frame per control step."""
    across = int(np.ceil(np.sqrt(len(episode.manifest.cameras))))
    for frame in episode.frames(depth=False):
        pictures = list(frame.rgb.items())
        down = -(-len(pictures) // across)
        width, height = _even(pictures[0][1].shape[1]), _even(pictures[0][1].shape[0])
        width, height = max(width, 240), max(height, 180)
        canvas = Image.new("RGB", (across * width, HEADER + down * height), _PAPER)
        draw = ImageDraw.Draw(canvas)
        _write_header(draw, episode, f"{frame.time_s:.2f} s")
        for i, (name, rgb) in enumerate(pictures):
            spot = (i % across * width, HEADER + i // across * height)
            canvas.paste(Image.fromarray(rgb).resize((width, height)), spot)
            draw.text((spot[0] + 6, spot[1] + 4), name, _INK, _font(13))
        yield np.asarray(canvas)


def _write_header(draw: ImageDraw.ImageDraw, episode: Episode, time: str = "") -> None:
    manifest = episode.manifest
    end = "success" if manifest.success else f"failed: {manifest.reason}"
    facts = f"{manifest.task}  {manifest.id}  {manifest.source}  {manifest.frames} frames  {end}"
    draw.text((6, 6), f"{facts}  {time}", _SOFT, _font(14))
    draw.text((6, 28), manifest.instruction, _INK, _font(16))


def _tile_size(picture: np.ndarray) -> tuple[int, int]:
    return TILE_WIDTH, round(TILE_WIDTH * picture.shape[0] / picture.shape[1])


def _even(size: int) -> int:
    return size + size % 2


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
