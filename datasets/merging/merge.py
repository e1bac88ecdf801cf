"""Merges LeRobot datasets: whole or not at all, the same bytes for any number of workers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from codediffuser.datagen.workers import run_tasks
from codediffuser.datasets.export_meta import DATA, VIDEO
from codediffuser.datasets.lerobot_files import CHUNK_FILES
from codediffuser.datasets.merging.data_files import FileJob, Renumbering, bring_over
from codediffuser.datasets.merging.merged_meta import Places, write_meta
from codediffuser.datasets.merging.sources import Source, open_sources
from codediffuser.datasets.merging.verify import verify_merge
from codediffuser.errors import DatasetError
from codediffuser.files import atomic_folder, remove_partials

FEW_FILES = 4
"""Fewer are written in this process: starting another takes longer."""


@dataclass(frozen=True, slots=True)
class MergeProgress:
    """One step is done: a file is in place, or a file's episodes are verified."""

    what: str
    done: int
    total: int

    @property
    def note(self) -> str:
        """For a progress bar."""
        return self.what


@dataclass(slots=True)
class _Plan:
    """Which files go where."""

    jobs: list[FileJob]
    tasks: dict[str, int]
    data: dict[tuple[int, tuple[int, int]], tuple[int, int]]
    videos: dict[str, Places]


def merge_datasets(
    roots: Sequence[Path],
    out: Path,
    *,
    workers: int = 1,
    link: bool = True,
    verify: bool = True,
    overwrite: bool = False,
) -> Iterator[MergeProgress]:
    """Join datasets of the same features; their episodes follow one another in the given order.

    Video files, and data files whose numbers stay the same, are hard links. Data files keep their
    cut: n small ones stay n small ones. What a killed merge left is removed by the next.

    Args:
        roots: Two datasets or more.
        out: Folder of the merged one; must not exist.
        workers: Processes.
        link: Whether files that stay the same are linked; otherwise they are copied.
        verify: Whether the first, middle and last frame of every episode are decoded and compared
            with those of its source before the dataset appears.
        overwrite: Replace a dataset at `out`.

    Raises:
        DatasetError: The datasets cannot be joined, `out` exists or is one of them, or what was
            written differs from its source.
        StorageError: The disk is full.
    """
    if any(out.resolve() == root.resolve() for root in roots):
        raise DatasetError(f"{out}: is one of the datasets to merge; choose another --out")
    if out.exists() and not overwrite:
        raise DatasetError(f"{out}: exists; choose another --out, or --overwrite to replace it")
    sources = open_sources(roots)
    remove_partials(out.parent, [out.name])
    with atomic_folder(out) as partial:
        plan = _plan(sources, partial, link=link)
        total = len(plan.jobs) + (sum(len(s.data_files()) for s in sources) if verify else 0)
        done = 0
        for name in _bring(plan.jobs, workers):
            done += 1
            yield MergeProgress(name, done, total)
        write_meta(partial, sources, plan.tasks, plan.data, plan.videos)
        for name in verify_merge(partial, sources, workers=workers) if verify else ():
            done += 1
            yield MergeProgress(name, done, total)


def _plan(sources: Sequence[Source], out: Path, *, link: bool) -> _Plan:
    tasks: dict[str, int] = {}
    plan = _Plan([], tasks, {}, {key: {} for key in sources[0].videos})
    for number, source in enumerate(sources):
        renamed = {old: tasks.setdefault(text, len(tasks)) for old, text in source.tasks.items()}
        numbers = Renumbering(source.first_episode, source.first_frame, renamed)
        for at in source.data_files():
            place = divmod(len(plan.data), CHUNK_FILES)
            plan.data[number, at] = place
            target = out / DATA.format(chunk_index=place[0], file_index=place[1])
            plan.jobs.append(FileJob(source.data_path(at), target, numbers, link))
        for key, places in plan.videos.items():
            assert isinstance(places, dict)
            for at in source.video_files(key):
                place = divmod(len(places), CHUNK_FILES)
                places[number, at] = place
                target = out / VIDEO.format(
                    video_key=key, chunk_index=place[0], file_index=place[1]
                )
                plan.jobs.append(FileJob(source.video_path(key, at), target, None, link))
    return plan


def _bring(jobs: Sequence[FileJob], workers: int) -> Iterator[str]:
    if workers == 1 or len(jobs) < FEW_FILES:
        for job in jobs:
            bring_over(job)
            yield job.source.name
        return
    slowest_s = 60.0 + max(math.ceil(job.source.stat().st_size / 1e6) for job in jobs)
    for outcome in run_tasks(bring_over, jobs, workers=workers, timeout_s=slowest_s):
        if outcome.value is None:
            raise DatasetError(f"{outcome.task.source}: could not be merged: {outcome.reason}")
        yield outcome.task.source.name
