"""Columns of one episode as an Arrow table, and the statistics that go with them, on disk."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.datasets.features import Feature
from codediffuser.datasets.stats import Histogram, Stats
from codediffuser.errors import DatasetError, ShapeError

Column = np.ndarray | Sequence[str]


@dataclass(slots=True)
class PartStats:
    """Statistics of one episode where those of its columns are not wanted or not possible."""

    stats: dict[str, Stats] = field(default_factory=dict)
    """By feature."""
    histograms: dict[str, list[Histogram]] = field(default_factory=dict)
    """By feature: one per channel, for the quantiles of a whole dataset."""
    pixel_counts: dict[str, np.ndarray] = field(default_factory=dict)
    """By feature: (3, 256) int64, how often each channel of a video had each value."""

    def save(self, path: Path) -> None:
        """Write one `.npz`, the same bytes for the same numbers."""
        arrays: dict[str, np.ndarray] = {}
        for key, stats in self.stats.items():
            arrays |= {f"stats/{key}/{name}": value for name, value in stats.items()}
        for key, channels in self.histograms.items():
            for i, histogram in enumerate(channels):
                arrays[f"histogram/{key}/{i}"] = np.stack([histogram.bins, histogram.counts])
        for key, counts in self.pixel_counts.items():
            arrays[f"pixels/{key}"] = counts
        with path.open("wb") as stream:
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: Path) -> PartStats:
        """Read what `save` wrote.

        Raises:
            DatasetError: The file is missing or damaged.
        """
        found = cls()
        try:
            with np.load(path, allow_pickle=False) as raw:
                for name in raw.files:
                    kind, key, *rest = name.split("/")
                    if kind == "stats":
                        found.stats.setdefault(key, {})[rest[0]] = raw[name]
                    elif kind == "histogram":
                        found.histograms.setdefault(key, []).append(Histogram(*raw[name]))
                    else:
                        found.pixel_counts[key] = raw[name]
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise DatasetError(f"{path}: not readable: {error}; run convert again") from None
        return found


def arrow_schema(features: Mapping[str, Feature]) -> pa.Schema:
    """Arrow types of the columns of these features."""
    return pa.schema([(key, _arrow_type(feature)) for key, feature in features.items()])


def arrow_table(
    features: Mapping[str, Feature], columns: Mapping[str, Column], length: int
) -> pa.Table:
    """Columns as a table.

    Args:
        features: Columns of the table, in their order.
        columns: Each feature's (T, size) array, or T strings.
        length: T.

    Raises:
        ShapeError: A column is missing or does not have its shape.
    """
    arrays = [_array(key, feature, columns, length) for key, feature in features.items()]
    return pa.Table.from_arrays(arrays, schema=arrow_schema(features))


def write_columns(table: pa.Table, path: Path) -> None:
    """Write the table of one part; it is soon read again, so nothing is packed."""
    pq.write_table(
        table, path, compression="none", use_dictionary=False, row_group_size=max(len(table), 1)
    )


def read_columns(path: Path) -> pa.Table:
    """Read the table of one part.

    Raises:
        DatasetError: The file is missing or damaged.
    """
    try:
        return pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise DatasetError(f"{path}: not readable: {error}; run convert again") from None


def _array(key: str, feature: Feature, columns: Mapping[str, Column], length: int) -> pa.Array:
    if key not in columns:
        raise ShapeError(f"column '{key}' is missing; there are: {', '.join(sorted(columns))}")
    if feature.dtype == "string":
        return pa.array(list(columns[key]), pa.string())
    values = np.ascontiguousarray(columns[key], dtype=feature.dtype)
    if values.size != length * feature.size or len(values) != length:
        raise ShapeError(f"{key}: expected shape ({length}, {feature.size}), got {values.shape}")
    flat = pa.array(values.reshape(-1))
    return flat if feature.size == 1 else pa.FixedSizeListArray.from_arrays(flat, feature.size)


def _arrow_type(feature: Feature) -> pa.DataType:
    scalar = {"float32": pa.float32(), "int64": pa.int64(), "string": pa.string()}[feature.dtype]
    return scalar if feature.size == 1 else pa.list_(scalar, feature.size)
