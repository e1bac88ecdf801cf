"""The first pictures of all episodes of a run, blended camera by camera (supplement, Fig. 5)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.sheets.raster import png_bytes
from codediffuser.errors import EpisodeError
from codediffuser.files import write_bytes


def overlay_name(camera: str) -> str:
    """File of a camera's overlay in the run."""
    return f"overlay_{camera}.png"


def overlay_episodes(run: Path, out: Path | None = None) -> Iterator[Path]:
    """Write `overlay_<camera>.png` for every camera and yield each path once it is there.

    What never moves stays sharp; what was reset differently from episode to episode becomes a
    cloud, and so does a camera that was knocked.

    Args:
        run: Folder with `episodes/`.
        out: Folder for the pictures; None takes the run's.

    Raises:
        EpisodeError: The run has no episode, or episodes have other cameras or picture sizes.
    """
    from PIL import Image

    folders = list_episodes(run)
    if not folders:
        raise EpisodeError(
            f"{run}: no episodes here; expected RUN/episodes/<id> from demo or import"
        )
    totals: dict[str, np.ndarray] = {}
    for folder in folders:
        first = Episode.open(folder).frame(0, depth=False).rgb
        if not totals:
            totals = {name: np.zeros(rgb.shape, dtype=np.uint32) for name, rgb in first.items()}
        _check_same(folder, totals, first)
        for name, rgb in first.items():
            totals[name] += rgb
    for name, total in totals.items():
        mean = np.rint(total / len(folders)).astype(np.uint8)
        path = (out or run) / overlay_name(name)
        write_bytes(path, png_bytes(Image.fromarray(mean)))
        yield path


def _check_same(
    folder: Path, totals: dict[str, np.ndarray], first: dict[str, np.ndarray]
) -> None:  # fmt: skip
    expected = {name: total.shape for name, total in totals.items()}
    found = {name: rgb.shape for name, rgb in first.items()}
    if expected != found:
        raise EpisodeError(
            f"{folder}: expected cameras and picture sizes {_listed(expected)} as in the first "
            f"episode of the run, found {_listed(found)}"
        )


def _listed(shapes: dict[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {shape[1]}x{shape[0]}" for name, shape in sorted(shapes.items()))
