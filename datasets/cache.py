"""Training windows from a memory-mapped copy of an export: derived, disposable, never the source.

LeRobot decodes the whole cloud column of every row it touches and reaches 3 to 14 windows a second.
The copy holds three plain arrays and is keyed by the fingerprint of the export, so an export that
changed has another one. It is built when it is absent, and built again when it is damaged.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from codediffuser.datasets import parquet_reader
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.export_meta import (
    DatasetDocument,
    cloud_config,
    dataset_fingerprint,
    find_document,
    load_info,
)
from codediffuser.datasets.features import ACTION, POINT_CHANNELS, POINTS, STATE
from codediffuser.datasets.windows import WindowSampler
from codediffuser.errors import CodeDiffuserError, DatasetError
from codediffuser.files import atomic_folder, remove_partials, sha256_file
from codediffuser.schema import Document

_log = logging.getLogger(__name__)

INDEX = "index.json"
ARRAYS = ("points", "state", "action")


class CacheDocument(Document):
    """What a cache says of itself (`schema: codediffuser.windows/1`)."""

    KIND: ClassVar[str] = "windows"
    VERSION: ClassVar[int] = 1

    fingerprint: str
    """Of the export that it was built from."""
    fps: int
    episode_starts: tuple[int, ...]
    episode_ids: tuple[str, ...]
    tasks: tuple[str, ...]
    """Sentence of each episode."""
    files: dict[str, str]
    """SHA-256 of each array file."""


@dataclass(frozen=True, slots=True)
class WindowCache:
    """The policy's arrays of a whole dataset, mapped from disk; F frames, E episodes, N points."""

    root: Path
    """Export that it was built from."""
    points: np.ndarray
    """(F, N, 5) float32."""
    state: np.ndarray
    """(F, 10) float32."""
    action: np.ndarray
    """(F, 10) float32."""
    episode_starts: np.ndarray
    """(E + 1,) int64: first frame of each episode, and F."""
    episode_ids: tuple[str, ...]
    tasks: tuple[str, ...]
    """Sentence of each episode."""
    fps: int
    fingerprint: str
    cloud: CloudConfig
    """How the clouds were made: closed loop has to make them the same way."""
    document: DatasetDocument | None
    """What `convert` wrote down; None for a dataset that LeRobot's tools made."""

    @classmethod
    def open(cls, root: Path, cache_folder: Path | None = None) -> Self:
        """Open the cache of an export, building it first if there is no sound one.

        Args:
            root: LeRobot dataset of the `pointcloud` profile.
            cache_folder: Where caches are kept; None for `.cache/windows` beside `root`.

        Raises:
            DatasetError: There is no such dataset, or it lacks a feature.
            SchemaVersionError: Its document is of a version that this code cannot read.
        """
        document = find_document(root)
        fingerprint = dataset_fingerprint(root)
        folder = (cache_folder or root.parent / ".cache" / "windows") / fingerprint[:16]
        index = _sound_index(folder, fingerprint)
        if index is None:
            remove_partials(folder.parent)
            _build(root, folder, fingerprint)
            index = CacheDocument.load(folder / INDEX)
        arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in ARRAYS}
        return cls(
            root=root,
            **arrays,
            episode_starts=np.array(index.episode_starts, dtype=np.int64),
            episode_ids=index.episode_ids,
            tasks=index.tasks,
            fps=index.fps,
            fingerprint=fingerprint,
            cloud=cloud_config(root),
            document=document,
        )

    @property
    def num_frames(self) -> int:
        """F."""
        return int(self.episode_starts[-1])

    @property
    def num_episodes(self) -> int:
        """E."""
        return len(self.episode_ids)

    def windows(
        self,
        episodes: Sequence[int] | None = None,
        *,
        n_obs_steps: int = 2,
        horizon: int = 16,
        drop_last: int = 0,
    ) -> WindowSampler:
        """Windows around the frames of some episodes; see `WindowSampler`.

        Args:
            episodes: Positions of episodes; None for all.
            n_obs_steps: To.
            horizon: H.
            drop_last: How many frames at the end of each episode are no window's middle.
        """
        return WindowSampler(
            self.points.reshape(self.num_frames, -1),
            self.state,
            self.action,
            self.episode_starts,
            episodes=range(self.num_episodes) if episodes is None else episodes,
            n_obs_steps=n_obs_steps,
            horizon=horizon,
            drop_last=drop_last,
        )


def _sound_index(folder: Path, fingerprint: str) -> CacheDocument | None:
    """The index of a cache whose files are all as they were written, or None."""
    if not folder.is_dir():
        return None
    try:
        index = CacheDocument.load(folder / INDEX)
    except CodeDiffuserError as error:
        _log.warning("building the window cache again: %s", error)
        return None
    whole = index.fingerprint == fingerprint and all(
        (folder / name).is_file() and sha256_file(folder / name) == digest
        for name, digest in index.files.items()
    )
    if not whole:
        _log.warning("building the window cache again: %s is damaged", folder)
        return None
    return index


def _build(root: Path, folder: Path, fingerprint: str) -> None:
    info = load_info(root)
    table = parquet_reader.read_episodes(root)
    total = int(table.starts[-1])
    channels = len(POINT_CHANNELS)
    sizes = {"points": parquet_reader.points_size(root, info), "state": 10, "action": 10}
    if sizes["points"] % channels:
        raise DatasetError(f"{root}: {POINTS} has {sizes['points']} numbers, not {channels} each")
    shapes: dict[str, tuple[int, ...]] = {name: (total, size) for name, size in sizes.items()}
    shapes["points"] = (total, sizes["points"] // channels, channels)
    keys = {"points": POINTS, "state": STATE, "action": ACTION}
    with atomic_folder(folder) as partial:
        arrays = {
            name: np.lib.format.open_memmap(
                partial / f"{name}.npy", mode="w+", dtype=np.float32, shape=shapes[name]
            )
            for name in ARRAYS
        }
        written = 0
        for batch in parquet_reader.read_frames(root, {keys[name]: sizes[name] for name in ARRAYS}):
            stop = written + len(batch[STATE])
            for name in ARRAYS:
                arrays[name][written:stop] = batch[keys[name]].reshape(-1, *shapes[name][1:])
            written = stop
        if written != total:
            raise DatasetError(f"{root}: expected {total} frames in the data files, got {written}")
        for array in arrays.values():
            array.flush()
        del arrays
        CacheDocument(
            fingerprint=fingerprint,
            fps=info["fps"],
            episode_starts=tuple(int(start) for start in table.starts),
            episode_ids=table.ids,
            tasks=table.tasks,
            files={f"{n}.npy": sha256_file(partial / f"{n}.npy") for n in ARRAYS},
        ).save(partial / INDEX)
