"""Pictures of a dataset's card: first frames with attention on them, and where hands went."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.datasets.export_meta import CARD_ASSETS
from codediffuser.datasets.exporting.source import Source
from codediffuser.errors import CodeDiffuserError

ROLE_RGB = {"pick": (255, 140, 0), "place": (0, 170, 255)}
MAX_HEIGHT = 120
MARGIN = 4


def draw_pictures(root: Path, episodes: Sequence[Episode], labelled: bool) -> dict[str, str]:
    """Draw what the card shows.

    Args:
        root: The export; pictures go to a folder in it.
        episodes: A few of its episodes.
        labelled: Whether they have labels, to be drawn.

    Returns:
        Caption of each picture by its path in the export.
    """
    folder = root / CARD_ASSETS
    folder.mkdir(exist_ok=True)
    rows = [_first_frames(episode, labelled) for episode in episodes]
    rows = [row for row in rows if row.size]
    captions = {}
    if rows:
        name = f"{CARD_ASSETS}/first_frames.png"
        _save(_stack(rows, axis=0), root / name)
        marked = "; attention: orange to pick, blue to place" if labelled else ""
        captions[name] = f"First frame of {len(rows)} episodes by every camera{marked}."
    name = f"{CARD_ASSETS}/motion.png"
    if _draw_motion(episodes, root / name):
        captions[name] = "The first three numbers of the state over time, one line per episode."
    return captions


def _first_frames(episode: Episode, labelled: bool) -> np.ndarray:
    """Pictures of all cameras side by side, (H, W, 3) uint8; empty without cameras."""
    frame = episode.frame(0)
    source = Source(episode.folder, labelled=labelled)
    pictures = []
    for camera in episode.manifest.cameras:
        picture = frame.rgb[camera.name]
        if labelled and camera.calibrated:
            picture = _overlay(picture, _masks(source, frame, camera.name))
        scale = min(1.0, MAX_HEIGHT / picture.shape[0])
        size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
        pictures.append(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    return _stack(pictures, axis=1) if pictures else np.zeros((0, 0, 3), np.uint8)


def _masks(source: Source, frame: object, camera: str) -> np.ndarray:
    from codediffuser.datagen.episode import Frame

    assert isinstance(frame, Frame)
    return source.masks(frame, camera)


def _overlay(rgb: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """Tint attended pixels."""
    drawn = rgb.astype(np.float32)
    for mask, color in zip(masks, ROLE_RGB.values(), strict=True):
        drawn[mask] = 0.45 * drawn[mask] + 0.55 * np.array(color)
    return drawn.astype(np.uint8)


def _stack(pictures: Sequence[np.ndarray], axis: int) -> np.ndarray:
    """Join pictures along an axis with white margins, padding smaller ones."""
    other = 1 - axis
    longest = max(p.shape[other] for p in pictures)
    padded = []
    for picture in pictures:
        pad = [(0, 0), (0, 0), (0, 0)]
        pad[other] = (0, longest - picture.shape[other])
        pad[axis] = (0, MARGIN)
        padded.append(np.pad(picture, pad, constant_values=255))
    return np.concatenate(padded, axis=axis)


def _save(rgb: np.ndarray, path: Path) -> None:
    cv2.imwrite(str(path), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))


def _draw_motion(episodes: Sequence[Episode], path: Path) -> bool:
    """Plot the first three numbers of the state; return whether there were any."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = episodes[0].manifest.motion.state_names[:3]
    figure = Figure(figsize=(8, 2.2))
    # Placed by hand: matplotlib's own layout draws everything twice.
    figure.subplots_adjust(left=0.06, right=0.99, bottom=0.2, top=0.9)
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    for i, (name, axis) in enumerate(zip(names, axes, strict=True)):
        for episode in episodes:
            try:
                state = episode.state
            except CodeDiffuserError:
                return False
            axis.plot(np.arange(len(state)) / episode.hz, state[:, i], lw=1)
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("s", fontsize=8)
        axis.tick_params(labelsize=7)
    # Without a fixed date the same data gives the same bytes.
    canvas.print_figure(path, dpi=110, metadata={"Software": None})
    return True
