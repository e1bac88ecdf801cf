"""One data file of a source with the rows numbered as in the merged dataset."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.errors import DatasetError
from codediffuser.files import atomic_path


@dataclass(frozen=True, slots=True)
class Renumbering:
    """How the rows of one source are called in the merged dataset."""

    first_episode: int
    first_frame: int
    tasks: Mapping[int, int]
    """Task index of the source to that of the merged dataset."""

    @property
    def changes_nothing(self) -> bool:
        """Whether rows keep their numbers."""
        same_tasks = all(old == new for old, new in self.tasks.items())
        return self.first_episode == 0 and self.first_frame == 0 and same_tasks


@dataclass(frozen=True, slots=True)
class FileJob:
    """One file to bring over."""

    source: Path
    target: Path
    numbers: Renumbering | None
    """None for a file without numbers: a video."""
    link: bool


def bring_over(job: FileJob) -> int:
    """Link or copy a file, or write it anew where its numbers change; return its size in bytes.

    Columns that do not change are decoded and encoded without ever becoming Python objects. Each
    row group stays one, since readers fetch whole episodes by them.

    Raises:
        DatasetError: The file is damaged, or lacks a column of LeRobot's.
    """
    job.target.parent.mkdir(parents=True, exist_ok=True)
    if job.numbers is None or job.numbers.changes_nothing:
        _link_or_copy(job)
        return job.target.stat().st_size
    try:
        with pq.ParquetFile(job.source, memory_map=True) as file, atomic_path(job.target) as out:
            schema = file.schema_arrow
            compression = {
                name: "zstd" if pa.types.is_string(schema.field(name).type) else "snappy"
                for name in schema.names
            }
            texts = [n for n in schema.names if pa.types.is_string(schema.field(n).type)]
            with pq.ParquetWriter(
                out, schema, compression=compression, use_dictionary=texts, write_statistics=False
            ) as writer:
                for group in range(file.num_row_groups):
                    table = _renumbered(file.read_row_group(group), job.numbers, job.source)
                    writer.write_table(table, row_group_size=max(len(table), 1))
    except (pa.ArrowException, OSError) as error:
        raise DatasetError(f"{job.source}: not readable: {error}") from None
    return job.target.stat().st_size


def _link_or_copy(job: FileJob) -> None:
    job.target.unlink(missing_ok=True)
    if job.link:
        try:
            os.link(job.source.resolve(), job.target)
        except OSError:  # another disk, or a file system without links
            pass
        else:
            return
    with atomic_path(job.target) as partial:
        shutil.copyfile(job.source, partial)


def _renumbered(table: pa.Table, numbers: Renumbering, path: Path) -> pa.Table:
    for name, offset in (
        ("episode_index", numbers.first_episode),
        ("index", numbers.first_frame),
        ("task_index", None),
    ):
        at = table.schema.get_field_index(name)
        if at < 0:
            raise DatasetError(f"{path}: lacks the column '{name}'")
        values = table.column(at).to_numpy()
        values = _mapped(values, numbers.tasks, path) if offset is None else values + offset
        table = table.set_column(at, table.schema.field(at), pa.array(values))
    return table


def _mapped(values: np.ndarray, tasks: Mapping[int, int], path: Path) -> np.ndarray:
    known, where = np.unique(values, return_inverse=True)
    unknown = [int(index) for index in known if int(index) not in tasks]
    if unknown:
        raise DatasetError(f"{path}: task_index {unknown[0]} stands for no sentence of the dataset")
    return np.array([tasks[int(index)] for index in known], dtype=np.int64)[where]
