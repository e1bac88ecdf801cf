"""Writes the files of LeRobot's v3.0 layout with pyarrow, one row group per episode.

LeRobot's own writer keeps statistics for each column of a flattened cloud, takes a second per
episode for them, and loses the session when it is killed. What it writes otherwise, we write too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.datasets.export_meta import (
    CODEBASE_VERSION,
    DATA,
    EPISODES,
    INFO,
    STATS,
    TASKS,
)
from codediffuser.datasets.features import DEFAULT_FEATURES, Feature
from codediffuser.datasets.stats import Stats, feature_stats, merge_stats
from codediffuser.errors import ShapeError
from codediffuser.files import write_json

CHUNK_FILES = 1000
FILE_MB = 100
Column = np.ndarray | Sequence[str]


class LeRobotWriter:
    """Writes a dataset into an empty folder, episode by episode; call `finish` at the end.

    Args:
        root: Folder to write into.
        features: Columns besides LeRobot's own.
        fps: Frames per second.
        robot_type: Name of the robot.
    """

    def __init__(
        self, root: Path, features: Mapping[str, Feature], *, fps: int, robot_type: str
    ) -> None:
        self.root = root
        self.features = {**features, **DEFAULT_FEATURES}
        self.fps = fps
        self.robot_type = robot_type
        self.num_frames = 0
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []
        self._stats: list[dict[str, Stats]] = []
        self._file_number = -1
        self._file_bytes = 0
        self._writer: pq.ParquetWriter | None = None
        self._schema = pa.schema([(k, _arrow_type(f)) for k, f in self.features.items()])

    def add_episode(
        self, columns: Mapping[str, Column], task: str, stats: Mapping[str, Stats] | None = None
    ) -> None:
        """Append one episode.

        Args:
            columns: Each feature's (T, size) array, or T strings.
            task: What was asked.
            stats: Statistics of features where those of the columns are not wanted.

        Raises:
            ShapeError: A column is missing or does not have its shape.
        """
        length = len(next(iter(columns.values())))
        full = {**columns, **self._own_columns(length, task)}
        arrays = [self._arrow(key, full, length) for key in self.features]
        table = pa.Table.from_arrays(arrays, schema=self._schema)
        chunk, file = self._write(table)
        found: dict[str, Stats] = {}
        for key, feature in self.features.items():
            if feature.dtype != "string":
                values = np.asarray(full[key]).reshape(length, feature.size)
                found[key] = (stats or {}).get(key) or feature_stats(values)
        self._stats.append(found)
        self._rows.append(
            {
                "episode_index": len(self._rows),
                "tasks": [task],
                "length": length,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self.num_frames,
                "dataset_to_index": self.num_frames + length,
                **{
                    f"stats/{key}/{name}": value.tolist()
                    for key, each in found.items()
                    for name, value in each.items()
                },
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
        )
        self.num_frames += length

    def finish(self) -> None:
        """Write everything that is known only at the end."""
        if self._writer is not None:
            self._writer.close()
        path = self.root / EPISODES.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist(self._rows), path)
        self._write_tasks()
        total = len(self._rows)
        merged = {key: merge_stats([s[key] for s in self._stats]) for key in self._stats[0]}
        write_json(
            self.root / STATS,
            {k: {n: v.tolist() for n, v in each.items()} for k, each in merged.items()},
        )
        write_json(
            self.root / INFO,
            {
                "codebase_version": CODEBASE_VERSION,
                "robot_type": self.robot_type,
                "total_episodes": total,
                "total_frames": self.num_frames,
                "total_tasks": len(self._tasks),
                "chunks_size": CHUNK_FILES,
                "data_files_size_in_mb": FILE_MB,
                "video_files_size_in_mb": 200,
                "fps": self.fps,
                "splits": {"train": f"0:{total}"},
                "data_path": DATA,
                "video_path": None,
                "features": {k: f.declaration() for k, f in self.features.items()},
            },
        )

    def _own_columns(self, length: int, task: str) -> dict[str, np.ndarray]:
        frame = np.arange(length)
        task_index = self._tasks.setdefault(task, len(self._tasks))
        return {
            "timestamp": (frame / self.fps).astype(np.float32),
            "frame_index": frame,
            "episode_index": np.full(length, len(self._rows)),
            "index": self.num_frames + frame,
            "task_index": np.full(length, task_index),
        }

    def _arrow(self, key: str, columns: Mapping[str, Column], length: int) -> pa.Array:
        feature = self.features[key]
        if key not in columns:
            raise ShapeError(f"column '{key}' is missing; there are: {', '.join(sorted(columns))}")
        if feature.dtype == "string":
            return pa.array(list(columns[key]), pa.string())
        values = np.ascontiguousarray(columns[key], dtype=feature.dtype)
        if values.size != length * feature.size or len(values) != length:
            raise ShapeError(
                f"{key}: expected shape ({length}, {feature.size}), got {values.shape}"
            )
        flat = pa.array(values.reshape(-1))
        return flat if feature.size == 1 else pa.FixedSizeListArray.from_arrays(flat, feature.size)

    def _write(self, table: pa.Table) -> tuple[int, int]:
        """Append to the open data file, or to a next one when it is full; return chunk and file."""
        if self._writer is None or self._file_bytes + table.nbytes > FILE_MB * 2**20:
            if self._writer is not None:
                self._writer.close()
            self._file_number += 1
            self._file_bytes = 0
            chunk, file = divmod(self._file_number, CHUNK_FILES)
            path = self.root / DATA.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema, compression="snappy")
        self._writer.write_table(table, row_group_size=len(table))
        self._file_bytes += table.nbytes
        return divmod(self._file_number, CHUNK_FILES)

    def _write_tasks(self) -> None:
        # LeRobot keeps sentences in the index of a pandas frame.
        import pandas as pd

        frame = pd.DataFrame({"task_index": list(self._tasks.values())}, index=list(self._tasks))
        frame.to_parquet(self.root / TASKS)


def _arrow_type(feature: Feature) -> pa.DataType:
    scalar = {"float32": pa.float32(), "int64": pa.int64(), "string": pa.string()}[feature.dtype]
    return scalar if feature.size == 1 else pa.list_(scalar, feature.size)
