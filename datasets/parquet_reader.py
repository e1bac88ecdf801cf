"""Reads the parquet files of a LeRobot v3.0 dataset, ours or one that LeRobot's tools made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.datasets.export_meta import INFO, load_info, require_features
from codediffuser.datasets.features import ACTION, EPISODE_ID, POINTS, STATE
from codediffuser.errors import DatasetError

REQUIRED = {POINTS: "float32", STATE: "float32", ACTION: "float32", EPISODE_ID: "string"}
BATCH_ROWS = 512


@dataclass(frozen=True, slots=True)
class EpisodeTable:
    """The episodes of a dataset, in the order of its frames."""

    starts: np.ndarray
    """(E + 1,) int64: first frame of each, and the number of all frames."""
    ids: tuple[str, ...]
    tasks: tuple[str, ...]
    """Sentence of each."""


def read_episodes(root: Path) -> EpisodeTable:
    """Read where episodes begin and what they are called.

    Raises:
        DatasetError: A file is missing or damaged, or episodes do not follow one another.
    """
    rows = read_episode_rows(root)
    spans = [(int(r["dataset_from_index"]), int(r["dataset_to_index"])) for r in rows]
    starts = [0, *(stop for _, stop in spans)]
    if [start for start, _ in spans] != starts[:-1] or any(a >= b for a, b in spans):
        raise DatasetError(
            f"{root}: episodes in meta/episodes do not follow one another: {spans[:8]}"
        )
    first_ids: dict[int, str] = {}
    for batch in iterate(root, ["episode_index", EPISODE_ID]):
        indices, ids = batch.column(0).to_pylist(), batch.column(1).to_pylist()
        for index, name in zip(indices, ids, strict=True):
            first_ids.setdefault(index, name)
    missing = [i for i in range(len(rows)) if i not in first_ids]
    if missing:
        raise DatasetError(f"{root}: the data files hold no frames of episodes {missing[:8]}")
    return EpisodeTable(
        np.array(starts, dtype=np.int64),
        tuple(first_ids[i] for i in range(len(rows))),
        tuple(row["tasks"][0] for row in rows),
    )


def read_episode_rows(root: Path) -> list[dict[str, Any]]:
    """All rows of `meta/episodes`, by episode index.

    Raises:
        DatasetError: There are none, or a file is damaged.
    """
    rows: list[dict[str, Any]] = []
    for path in _files(root, "meta/episodes"):
        try:
            rows += pq.read_table(path).to_pylist()
        except (pa.ArrowException, OSError) as error:
            raise DatasetError(f"{path}: not readable: {error}") from None
    return sorted(rows, key=lambda row: int(row["episode_index"]))


def points_size(root: Path, info: Mapping[str, Any]) -> int:
    """How many numbers the cloud of one frame has.

    Raises:
        DatasetError: The dataset lacks a feature of the `pointcloud` profile.
    """
    require_features(root, dict(info), REQUIRED)
    shape = info["features"][POINTS]["shape"]
    if len(shape) != 1:
        raise DatasetError(f"{root / INFO}: expected a flat shape of {POINTS}, got {shape}")
    return int(shape[0])


def read_frames(root: Path, sizes: Mapping[str, int]) -> Iterator[dict[str, np.ndarray]]:
    """Stream vector columns in frame order.

    Args:
        root: Dataset.
        sizes: Length of each column's vectors.

    Yields:
        (M, size) float32 of each column for some hundred frames.

    Raises:
        DatasetError: A file is damaged, frames are out of order, or a vector has another length.
    """
    expected = 0
    for batch in iterate(root, ["index", *sizes]):
        index = batch.column(0).to_numpy()
        if not np.array_equal(index, np.arange(expected, expected + len(index))):
            raise DatasetError(
                f"{root}: frames are out of order from {expected} on, found index {index[:4]}"
            )
        expected += len(index)
        yield {
            key: vectors(batch.column(i + 1), size, f"{root}: {key}")
            for i, (key, size) in enumerate(sizes.items())
        }


def iterate(root: Path, columns: list[str]) -> Iterator[pa.RecordBatch]:
    """Stream some columns of all data files.

    Raises:
        DatasetError: A file is missing or damaged, or lacks a column.
    """
    load_info(root)
    for path in _files(root, "data"):
        try:
            with pq.ParquetFile(path) as file:
                lacking = [name for name in columns if name not in file.schema_arrow.names]
                if lacking:
                    raise DatasetError(f"{path}: lacks the column '{lacking[0]}'")
                for batch in file.iter_batches(BATCH_ROWS, columns=columns):
                    yield batch.select(columns)
        except (pa.ArrowException, OSError) as error:
            raise DatasetError(
                f"{path}: not readable: {error}; run `codediffuser convert RUN` again"
            ) from None


def vectors(column: pa.Array, size: int, where: str) -> np.ndarray:
    """A column of numbers or of lists as (M, size).

    Both of Arrow's list types occur, by who wrote the file.

    Raises:
        DatasetError: A row is missing or has another length.
    """
    is_list = pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type)
    flat = (column.flatten() if is_list else column).to_numpy(zero_copy_only=False)
    if column.null_count or len(flat) != len(column) * size:
        raise DatasetError(f"{where}: expected {size} numbers in each row")
    return np.asarray(flat.reshape(len(column), size))


def _files(root: Path, part: str) -> list[Path]:
    files = sorted((root / part).glob("*/*.parquet"))
    if not files:
        raise DatasetError(f"{root / part}: no parquet files; run `codediffuser convert RUN` again")
    return files
