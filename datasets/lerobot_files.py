"""The data and video files of LeRobot's v3.0 layout: many episodes each, up to about a size."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.datasets.export_meta import DATA, VIDEO
from codediffuser.datasets.exporting.columns import arrow_schema
from codediffuser.datasets.exporting.video import VideoJoiner
from codediffuser.datasets.features import Feature
from codediffuser.errors import DatasetError

CHUNK_FILES = 1000
FILE_MB = 100
VIDEO_FILE_MB = 200


class DataFiles:
    """The data files, each of about `FILE_MB`."""

    def __init__(self, root: Path, features: Mapping[str, Feature]) -> None:
        self.root = root
        self._schema = arrow_schema(features)
        # Pictures in text shrink by a quarter under zstd; numbers gain little.
        self._compression = {
            key: "zstd" if feature.dtype == "string" else "snappy"
            for key, feature in features.items()
        }
        self._number = -1
        self._bytes = 0
        self._writer: pq.ParquetWriter | None = None

    def append(self, table: pa.Table) -> tuple[int, int]:
        """Write to the open file, or to a next one when it is full; return chunk and file."""
        if self._writer is None or self._bytes + table.nbytes > FILE_MB * 2**20:
            self.close()
            self._number += 1
            self._bytes = 0
            chunk, file = divmod(self._number, CHUNK_FILES)
            path = self.root / DATA.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema, compression=self._compression)
        self._writer.write_table(table, row_group_size=len(table))
        self._bytes += table.nbytes
        return divmod(self._number, CHUNK_FILES)

    def close(self) -> None:
        """Close the last file."""
        if self._writer is not None:
            self._writer.close()


class VideoFiles:
    """The files of one video feature, each of about `VIDEO_FILE_MB`."""

    def __init__(self, root: Path, key: str, fps: int) -> None:
        self.root, self.key, self.fps = root, key, fps
        self._number = -1
        self._joiner: VideoJoiner | None = None

    def append(self, video: Path, length: int) -> dict[str, Any]:
        """Append one episode; return what its row says about it."""
        joiner = self._joiner
        if joiner is None or joiner.bytes + video.stat().st_size > VIDEO_FILE_MB * 2**20:
            self.close()
            self._number += 1
            joiner = self._joiner = VideoJoiner(self._path(), self.fps)
        start = joiner.frames
        found = joiner.append(video)
        if found != length:
            raise DatasetError(f"{video}: expected {length} pictures, one a row, found {found}")
        chunk, file = divmod(self._number, CHUNK_FILES)
        return {
            f"videos/{self.key}/chunk_index": chunk,
            f"videos/{self.key}/file_index": file,
            f"videos/{self.key}/from_timestamp": start / self.fps,
            f"videos/{self.key}/to_timestamp": (start + length) / self.fps,
        }

    def close(self) -> None:
        """Close the last file."""
        if self._joiner is not None:
            self._joiner.close()

    def _path(self) -> Path:
        chunk, file = divmod(self._number, CHUNK_FILES)
        return self.root / VIDEO.format(video_key=self.key, chunk_index=chunk, file_index=file)
