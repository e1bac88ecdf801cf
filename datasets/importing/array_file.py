"""One interface to formats that store one row per frame: ALOHA, robomimic, ManiSkill, zarr."""

from __future__ import annotations

import abc
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.errors import DatasetError

BLOCK_BYTES = 32 << 20
"""Rows that are packed together are read together, up to this size."""


class Column:
    """Rows of one data set that belong to one episode.

    Args:
        data: An HDF5 or zarr array, (N, ...).
        start: Its row of the episode's first frame.
        length: How many rows belong to the episode.
    """

    def __init__(self, data: Any, start: int, length: int) -> None:
        self._data = data
        self._start = start
        self.length = length
        self.shape: tuple[int, ...] = tuple(data.shape[1:])
        self.dtype: np.dtype = data.dtype
        chunks = getattr(data, "chunks", None)
        row_bytes = max(int(np.prod(self.shape)) * self.dtype.itemsize, 1)
        packed_together = int(chunks[0]) if chunks else 1
        self._block = max(1, min(packed_together, BLOCK_BYTES // row_bytes))
        self._held: tuple[int, Any] = (-1, None)

    def row(self, k: int) -> Any:
        """Row of frame k."""
        if not 0 <= k < self.length:
            raise DatasetError(f"row {k} of {self.length} was asked for")
        row = self._start + k
        first = row - row % self._block
        if self._held[0] != first:
            stop = min(first + self._block, self._start + self.length)
            self._held = (first, self._data[first:stop])
        return self._held[1][row - first]


class ArrayFile(abc.ABC):
    """A file or folder of episodes with one row per frame; `contextlib.closing` closes it.

    A subclass fills `episodes` when it is built.
    """

    format: str
    """Name for reports."""

    hz: int
    """Usual frames per second of the format, unless the file says."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.episodes: list[str] = []
        """Names of all episodes, in the file's order."""
        self.damage: list[str] = []

    @abc.abstractmethod
    def columns(self, episode: str) -> dict[str, Column]:
        """Data sets with one row per frame, by path."""

    @abc.abstractmethod
    def close(self) -> None:
        """Close the file."""

    def success(self, episode: str) -> bool | None:
        """Whether an episode succeeded; None when the file does not tell."""
        return None

    def instruction(self, episode: str) -> str:
        """What was asked; empty when the file does not tell."""
        return ""

    def calibration(self, episode: str, group: str) -> tuple[np.ndarray, np.ndarray]:
        """K (3, 3) and T_world_camera (T, 4, 4) of a camera.

        Raises:
            DatasetError: The format holds none.
        """
        raise DatasetError(
            f"{self.path}: {self.format} holds no calibration; give K and T_world_camera, no info"
        )


def natural_order(name: str) -> tuple[str, int]:
    """Sorts `demo_10` after `demo_9`."""
    stem, _, number = name.rpartition("_")
    return (stem, int(number)) if number.isdigit() else (name, -1)
