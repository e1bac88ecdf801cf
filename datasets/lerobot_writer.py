"""Writes the files of LeRobot's v3.0 layout with pyarrow, one row group per episode.

LeRobot's own writer keeps statistics for each column of a flattened cloud, takes a second per
episode for them, and loses the session when it is killed. What it writes otherwise, we write too.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    VIDEO,
)
from codediffuser.datasets.exporting.columns import PartStats, arrow_schema
from codediffuser.datasets.exporting.pictures import pixel_stats
from codediffuser.datasets.features import DEFAULT_FEATURES, Feature, VideoFeature
from codediffuser.datasets.lerobot_files import (
    CHUNK_FILES,
    FILE_MB,
    VIDEO_FILE_MB,
    DataFiles,
    VideoFiles,
)
from codediffuser.datasets.stats import (
    QUANTILES,
    Histogram,
    Stats,
    feature_stats,
    merge_stats,
    with_quantiles,
)
from codediffuser.errors import ShapeError
from codediffuser.files import write_json


class LeRobotWriter:
    """Writes a dataset into an empty folder, episode by episode; call `finish` at the end.

    Args:
        root: Folder to write into.
        features: Columns besides LeRobot's own, and videos.
        fps: Frames per second.
        robot_type: Name of the robot.
    """

    def __init__(
        self,
        root: Path,
        features: Mapping[str, Feature | VideoFeature],
        *,
        fps: int,
        robot_type: str,
    ) -> None:
        self.root = root
        self.videos = {k: f for k, f in features.items() if isinstance(f, VideoFeature)}
        own = {k: f for k, f in features.items() if isinstance(f, Feature)}
        self.features = {**own, **DEFAULT_FEATURES}
        self.fps = fps
        self.robot_type = robot_type
        self.num_frames = 0
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []
        self._stats: list[dict[str, Stats]] = []
        self._exact = _ExactQuantiles()
        self._files = DataFiles(root, self.features)
        self._video_files = {key: VideoFiles(root, key, fps) for key in self.videos}

    def add_episode(
        self,
        table: pa.Table,
        task: str,
        stats: PartStats | None = None,
        videos: Mapping[str, Path] | None = None,
    ) -> None:
        """Append one episode.

        Args:
            table: Its columns without LeRobot's own, see `arrow_table`.
            task: What was asked.
            stats: Statistics where those of the columns are not wanted, and those of the videos.
            videos: File of each video feature; it holds exactly this episode.

        Raises:
            ShapeError: A column or a video is missing.
            DatasetError: A video has not one picture for each row.
        """
        length, stats = len(table), stats or PartStats()
        own = self._own_columns(length, task)
        table = pa.Table.from_arrays(
            [
                table[key].combine_chunks() if key not in own else pa.array(own[key])
                for key in self._require(table)
            ],
            schema=arrow_schema(self.features),
        )
        found = {
            key: stats.stats.get(key) or feature_stats(_numbers(table[key], feature.size))
            for key, feature in self.features.items()
            if feature.dtype != "string"
        }
        for key, counts in stats.pixel_counts.items():
            found[key] = pixel_stats(counts, length)
        self._exact.add(table, self.features, stats)
        chunk, file = self._files.append(table)
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
                **self._append_videos(videos or {}, length),
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
        self._files.close()
        for files in self._video_files.values():
            files.close()
        path = self.root / EPISODES.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist(self._rows), path)
        total = len(self._rows)
        merged = {key: merge_stats([s[key] for s in self._stats]) for key in self._stats[0]}
        merged = self._exact.replace(merged)
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
                "video_files_size_in_mb": VIDEO_FILE_MB,
                "fps": self.fps,
                "splits": {"train": f"0:{total}"},
                "data_path": DATA,
                "video_path": VIDEO if self.videos else None,
                "features": {
                    **{key: video.declaration() for key, video in self.videos.items()},
                    **{key: feature.declaration() for key, feature in self.features.items()},
                },
            },
        )
        self._write_tasks()

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

    def _require(self, table: pa.Table) -> list[str]:
        lacking = [k for k in self.features if k not in table.schema.names]
        lacking = [k for k in lacking if k not in DEFAULT_FEATURES]
        if lacking:
            raise ShapeError(
                f"column '{lacking[0]}' is missing; there are: {', '.join(table.schema.names)}"
            )
        return list(self.features)

    def _append_videos(self, videos: Mapping[str, Path], length: int) -> dict[str, Any]:
        row: dict[str, Any] = {}
        for key, files in self._video_files.items():
            if key not in videos:
                raise ShapeError(f"video '{key}' is missing; there are: {', '.join(videos)}")
            row |= files.append(videos[key], length)
        return row

    def _write_tasks(self) -> None:
        # LeRobot keeps sentences in the index of a pandas frame.
        import pandas as pd

        frame = pd.DataFrame({"task_index": list(self._tasks.values())}, index=list(self._tasks))
        frame.to_parquet(self.root / TASKS)


class _ExactQuantiles:
    """Quantiles of all frames together, which those of episodes do not tell."""

    def __init__(self) -> None:
        self._values: dict[str, list[np.ndarray]] = {}
        self._histograms: dict[str, list[list[Histogram]]] = {}
        self._pixels: dict[str, np.ndarray] = {}
        self._frames = 0

    def add(self, table: pa.Table, features: Mapping[str, Feature], stats: PartStats) -> None:
        self._frames += len(table)
        for key, feature in features.items():
            if feature.dtype != "string" and key not in stats.stats:
                self._values.setdefault(key, []).append(_numbers(table[key], feature.size))
        for key, channels in stats.histograms.items():
            self._histograms.setdefault(key, []).append(channels)
        for key, counts in stats.pixel_counts.items():
            self._pixels[key] = self._pixels.get(key, 0) + counts

    def replace(self, merged: Mapping[str, Stats]) -> dict[str, Stats]:
        """The same statistics with quantiles of all frames."""
        found = dict(merged)
        for key, values in self._values.items():
            numbers = np.concatenate(values).astype(np.float64)
            found[key] = with_quantiles(
                found[key], np.quantile(numbers, list(QUANTILES.values()), axis=0)
            )
        for key, parts in self._histograms.items():
            channels = [Histogram.sum(each).quantiles() for each in zip(*parts, strict=True)]
            found[key] = with_quantiles(found[key], np.stack(channels, axis=1))
        for key, counts in self._pixels.items():
            found[key] = pixel_stats(counts, self._frames)
        return found


def _numbers(column: pa.ChunkedArray, size: int) -> np.ndarray:
    """A column as (T, size)."""
    flat = column.combine_chunks()
    if size > 1:
        flat = flat.flatten()
    return np.asarray(flat.to_numpy(zero_copy_only=False)).reshape(-1, size)
