"""Episodes of a dataset as arrays, one in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.datasets import parquet_reader
from codediffuser.datasets.export_meta import DATA
from codediffuser.datasets.features import DEFAULT_FEATURES

SCALARS = tuple(DEFAULT_FEATURES)


@dataclass(frozen=True, slots=True)
class EpisodeRows:
    """The numbers of one episode of T frames."""

    where: str
    """Folder and number, for findings."""
    meta: dict[str, Any]
    """Its row of `meta/episodes`."""
    columns: dict[str, np.ndarray]
    """(T, D) of every numeric column, LeRobot's own among them."""

    @property
    def length(self) -> int:
        """Frames that were found."""
        return len(self.columns["index"])

    def scalar(self, key: str) -> np.ndarray:
        """One of LeRobot's own columns, (T,)."""
        return self.columns[key][:, 0]


def numeric_sizes(features: dict[str, Any]) -> dict[str, int]:
    """Length of the vectors of every numeric column that a dataset declares."""
    return {
        key: int(np.prod(feature["shape"]))
        for key, feature in features.items()
        if feature["dtype"] not in ("video", "image", "string")
    }


def iterate_episodes(
    root: Path, rows: Sequence[dict[str, Any]], sizes: dict[str, int]
) -> Iterator[EpisodeRows]:
    """Cut the stream of frames into the episodes that the metadata names.

    Raises:
        DatasetError: A data file is damaged, or its frames are out of order.
    """
    stream = parquet_reader.read_frames(root, sizes)
    held: dict[str, np.ndarray] = {k: np.zeros((0, n), np.float32) for k, n in sizes.items()}
    for row in rows:
        length = int(row["length"])
        while len(held["index"]) < length:
            batch = next(stream, None)
            if batch is None:
                break
            held = {key: np.concatenate([held[key], batch[key]]) for key in sizes}
        part = {key: values[:length] for key, values in held.items()}
        held = {key: values[length:] for key, values in held.items()}
        where = f"{root / DATA.split('/')[0]}, episode {row['episode_index']}"
        yield EpisodeRows(where, row, part)
