"""zarr as diffusion_policy and DP3 read it: `data/<name>` over all frames, `meta/episode_ends`.

Layout: real-stanford/diffusion_policy, `replay_buffer.py`; names of DP3 (`point_cloud`, `state`,
`action`) and, with several cameras, `img_<camera>`, `depth_<camera>`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets import clouds, episode_clouds
from codediffuser.datasets.exporting import h5_parts, pictures, source
from codediffuser.datasets.exporting.format import FORMATS, ExportFormat, same_for_all
from codediffuser.datasets.exporting.h5_parts import (
    PicturePaths,
    open_part,
    write_cloud,
    write_pictures,
)
from codediffuser.datasets.exporting.part import Part
from codediffuser.datasets.exporting.source import Source
from codediffuser.labeling import attention, attention_2d, motion

STORE = "replay_buffer.zarr"
PATHS = PicturePaths(rgb="img_{camera}", depth="depth_{camera}", mask="mask_{camera}")
ROWS = 256
"""Rows of vectors per chunk, and of anything that are in memory at a time."""


@FORMATS.add("zarr")
@dataclass(frozen=True)
class ZarrFormat(ExportFormat):
    """A replay buffer in zarr format 2."""

    NAME = "zarr"
    PROFILES = ("pointcloud", "portable", "masked-rgb")

    def modules(self) -> tuple[ModuleType, ...]:
        """The code that decides the bytes of a part."""
        return (h5_parts, pictures, source, clouds, episode_clouds, attention, attention_2d, motion)

    def make(self, source: Source, folder: Path) -> None:
        """Write the arrays of one episode."""
        with open_part(folder, "w") as file:
            file["action"] = source.episode.actions
            file["state"] = source.episode.state
            if self.options.profile == "pointcloud":
                write_cloud(file, "point_cloud", source, self.options.cloud)
            else:
                write_pictures(file, source, self.options, PATHS, self.labelled)

    def assemble(
        self, root: Path, parts: Sequence[Part], manifests: Sequence[EpisodeManifest]
    ) -> None:
        """Lay the episodes behind one another."""
        import zarr

        lengths = [m.frames for m in manifests]
        shapes = [_shapes(part) for part in parts]
        store = zarr.open_group(str(root / STORE), mode="w", zarr_version=2)
        arrays = {
            name: store.create_dataset(
                f"data/{name}",
                shape=(sum(lengths), *shape),
                chunks=(ROWS if len(shape) == 1 else 1, *shape),
                dtype=dtype,
            )
            for name, (shape, dtype) in same_for_all(manifests, "arrays", shapes).items()
        }
        stops = np.cumsum(lengths)
        for part, stop, length in zip(parts, stops, lengths, strict=True):
            with open_part(part.folder) as file:
                for name, array in arrays.items():
                    _copy_rows(file[name], 0, array, int(stop) - length, length)
        store.create_dataset("meta/episode_ends", data=stops.astype(np.int64))
        store.attrs["episode_ids"] = [m.id for m in manifests]
        store.attrs["instructions"] = [m.instruction for m in manifests]
        store.attrs["hz"] = manifests[0].hz

    def recover(self, previous: Path, index: int, folder: Path) -> bool:
        """Take the rows of one episode."""
        import zarr

        store = zarr.open_group(str(previous / STORE), mode="r")
        ends = store["meta/episode_ends"][:]
        start, stop = int(ends[index - 1]) if index else 0, int(ends[index])
        with open_part(folder, "w") as file:
            for name, array in sorted(store["data"].arrays()):
                shape = (stop - start, *array.shape[1:])
                target = file.create_dataset(
                    name, shape, array.dtype, chunks=(1, *shape[1:]) if len(shape) > 2 else None
                )
                _copy_rows(array, start, target, 0, stop - start)
        return True


def _shapes(part: Part) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape of one row and dtype of each array."""
    with open_part(part.folder) as file:
        return {name: (array.shape[1:], str(array.dtype)) for name, array in file.items()}


def _copy_rows(source: Any, first: int, target: Any, to: int, count: int) -> None:
    for k in range(0, count, ROWS):
        stop = min(k + ROWS, count)
        target[to + k : to + stop] = source[first + k : first + stop]
