"""Is a merged dataset what its sources were? First, middle and last frame of every episode."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from codediffuser.datagen.workers import run_tasks
from codediffuser.datasets.export_meta import DATA, VIDEO
from codediffuser.datasets.merging.sources import Source
from codediffuser.datasets.parquet_reader import read_episode_rows
from codediffuser.errors import DatasetError

NUMBERS = ("episode_index", "index", "task_index")
"""Columns that merging changes; what they must be is checked apart."""


@dataclass(frozen=True, slots=True)
class _Job:
    """The episodes of one source's data file, beside their rows in the merged dataset."""

    merged: Path
    source: Path
    videos: tuple[str, ...]
    fps: int
    pairs: tuple[tuple[dict[str, Any], dict[str, Any]], ...]


def verify_merge(merged: Path, sources: Sequence[Source], *, workers: int = 1) -> Iterator[str]:
    """Compare episodes with those of their sources, a file at a time.

    Yields:
        The name of each source file whose episodes are the same.

    Raises:
        DatasetError: A frame differs, an episode is missing, or rows carry wrong numbers.
    """
    rows = read_episode_rows(merged)
    if len(rows) != sum(len(source.rows) for source in sources):
        raise DatasetError(f"{merged}: holds {len(rows)} episodes, its sources hold others")
    jobs = []
    for source in sources:
        for place in source.data_files():
            pairs = tuple(
                (_needed(row), _needed(rows[source.first_episode + i]))
                for i, row in enumerate(source.rows)
                if (row["data/chunk_index"], row["data/file_index"]) == place
            )
            jobs.append(_Job(merged, source.root, source.videos, source.info["fps"], pairs))
    if workers == 1 or len(jobs) == 1:
        yield from (_verify(job) for job in jobs)
        return
    for outcome in run_tasks(_verify, jobs, workers=workers):
        if outcome.value is None:
            raise DatasetError(f"{outcome.task.source}: could not be verified: {outcome.reason}")
        yield outcome.value


class FrameReader:
    """Hashes of frames of one dataset; neighbouring episodes share what was read.

    Args:
        root: Dataset.
        videos: Names of its video features.
        fps: Frames per second.
    """

    def __init__(self, root: Path, videos: Sequence[str], fps: int) -> None:
        self.root, self.videos, self.fps = root, videos, fps
        self._groups: dict[Path, dict[int, list[int]]] = {}
        self._held: tuple[Path, list[int], pa.Table] | None = None

    def hashes(self, row: dict[str, Any]) -> dict[int, str]:
        """SHA-256 of what the first, middle and last frame hold, pictures decoded.

        Args:
            row: The episode's, of `meta/episodes`.

        Raises:
            DatasetError: A frame or a picture is not there, or its rows carry wrong numbers.
        """
        length, first = int(row["length"]), int(row["dataset_from_index"])
        frames = sorted({0, length // 2, length - 1})
        table = self._episode(row)
        if table.column("index").to_pylist() != list(range(first, first + length)):
            raise DatasetError(
                f"{self.root}: rows of episode {row['episode_index']} carry other numbers than "
                "its metadata"
            )
        kept = table.drop_columns([n for n in NUMBERS if n in table.column_names])
        hashes = {f: hashlib.sha256(_row_bytes(kept, f)) for f in frames}
        for key in self.videos:
            path = self.root / VIDEO.format(
                video_key=key,
                chunk_index=row[f"videos/{key}/chunk_index"],
                file_index=row[f"videos/{key}/file_index"],
            )
            start_s = float(row[f"videos/{key}/from_timestamp"])
            for frame, pixels in _pictures(path, start_s, frames, self.fps).items():
                hashes[frame].update(pixels)
        return {frame: each.hexdigest() for frame, each in hashes.items()}

    def _episode(self, row: dict[str, Any]) -> pa.Table:
        path = self.root / DATA.format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        wanted = int(row["episode_index"])
        if path not in self._groups:
            self._groups[path] = _groups_of_episodes(path)
        groups = self._groups[path].get(wanted, [])
        if self._held is None or self._held[:2] != (path, groups):
            with pq.ParquetFile(path, memory_map=True) as file:
                self._held = (path, groups, file.read_row_groups(groups))
        table = self._held[2]
        table = table.filter(pc.equal(table.column("episode_index"), wanted))
        if len(table) != int(row["length"]):
            raise DatasetError(
                f"{path}: expected {row['length']} rows of episode {wanted}, found {len(table)}"
            )
        return table


def _verify(job: _Job) -> str:
    source = FrameReader(job.source, job.videos, job.fps)
    merged = FrameReader(job.merged, job.videos, job.fps)
    for before, after in job.pairs:
        told, found = source.hashes(before), merged.hashes(after)
        wrong = [frame for frame in told if told[frame] != found[frame]]
        if wrong or before["tasks"] != after["tasks"]:
            what = f"frame {wrong[0]} differs" if wrong else "its sentence differs"
            raise DatasetError(
                f"{job.merged}: episode {after['episode_index']}, which was episode "
                f"{before['episode_index']} of {job.source}: {what}; nothing was kept"
            )
    return job.source.name


def _needed(row: dict[str, Any]) -> dict[str, Any]:
    """A row without its statistics, which are most of it."""
    return {name: value for name, value in row.items() if not name.startswith("stats/")}


def _groups_of_episodes(path: Path) -> dict[int, list[int]]:
    """Row groups that hold each episode."""
    found: dict[int, list[int]] = {}
    with pq.ParquetFile(path, memory_map=True) as file:
        for group in range(file.num_row_groups):
            column = file.read_row_group(group, columns=["episode_index"]).column(0)
            for episode in pc.unique(column).to_pylist():
                found.setdefault(episode, []).append(group)
    return found


def _row_bytes(table: pa.Table, frame: int) -> bytes:
    """Names and values of one row, whichever of Arrow's list types a writer chose for them."""
    found = []
    for name in sorted(table.column_names):
        column = table.column(name).slice(frame, 1).combine_chunks()
        if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
            column = column.flatten()
        if pa.types.is_primitive(column.type):
            values = column.to_numpy(zero_copy_only=False).tobytes()
        else:
            values = repr(column.to_pylist()).encode()
        found += [name.encode(), values]
    return b"\0".join(found)


def _pictures(path: Path, start_s: float, frames: Sequence[int], fps: int) -> dict[int, bytes]:
    """Decoded pictures of some frames of one episode in a file of many."""
    found: dict[int, bytes] = {}
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.time_base is not None
        for frame in frames:
            wanted_s = start_s + frame / fps
            container.seek(int(wanted_s / stream.time_base), stream=stream, backward=True)
            for picture in container.decode(stream):
                if picture.time is not None and picture.time >= wanted_s - 0.5 / fps:
                    found[frame] = picture.to_ndarray(format="rgb24").tobytes()
                    break
            if frame not in found:
                raise DatasetError(f"{path}: no picture at {wanted_s:.3f} s")
    return found
