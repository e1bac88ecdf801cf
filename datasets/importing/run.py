"""Imports recordings into a run: plan, skip what is there, write each episode whole, report.

Killed at any moment and run again, it ends with the same files as without the kill.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.episode import load_manifest
from codediffuser.datagen.episode_writer import EpisodeFacts, write_episode
from codediffuser.datagen.workers import run_tasks
from codediffuser.datasets.importing.array_file import ArrayFile
from codediffuser.datasets.importing.array_steps import ArraySteps
from codediffuser.datasets.importing.bag_steps import BagSteps
from codediffuser.datasets.importing.bag_sync import SyncedEpisode, synchronise
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.facts import (
    config_hash,
    episode_facts,
    instruction_at,
    recording_record,
)
from codediffuser.datasets.importing.jobs import Job, plan_jobs
from codediffuser.datasets.importing.limits import refusal
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.segments import Segment
from codediffuser.datasets.importing.sources import find_sources, open_source
from codediffuser.errors import ConfigError, DatasetError, EpisodeError, ShapeError
from codediffuser.files import remove_partials
from codediffuser.schema import Document, Strict

REPORT = "import.json"
TASK_TIMEOUT_S = 24 * 3600.0
"""One episode may be hours of a bag."""

Outcome = Literal["imported", "kept", "refused"]


class ImportedEpisode(Strict):
    """What became of one segment."""

    id: str
    recording: str
    """`RECORDING#SEGMENT`."""
    outcome: Literal["imported", "refused"]
    reason: str = ""
    """Why it was refused."""
    frames: int = 0


class ImportReport(Document):
    """What `RUN/import.json` says (`schema: codediffuser.import_report/1`), as planned."""

    KIND: ClassVar[str] = "import_report"
    VERSION: ClassVar[int] = 1

    config_sha256: str
    episodes: tuple[ImportedEpisode, ...]


@dataclass(frozen=True, slots=True)
class ImportResult:
    """What became of one segment, and how fast."""

    job: Job
    outcome: Outcome
    reason: str = ""
    frames: int = 0
    seconds: float = 0.0

    @property
    def note(self) -> str:
        """A word for the progress bar."""
        return f"{self.job.id} {self.outcome}"


@dataclass(frozen=True, slots=True)
class _Task:
    job: Job
    run: Path
    config: ImportConfig


def import_recordings(
    source: Path,
    config: ImportConfig,
    run: Path,
    *,
    config_folder: Path | None = None,
    workers: int = 1,
    overwrite: bool = False,
) -> Iterator[ImportResult]:
    """Import everything at a path into a run; results come as they are ready.

    Args:
        source: A recording, or a folder of several.
        config: How they become episodes.
        run: Run folder; its other episodes stay.
        config_folder: What the folder of scenes is relative to; None: the current folder.
        workers: Processes; 1 works in this one.
        overwrite: Make episodes again that are there, also from other recordings. Their labels
            are lost.

    Raises:
        DatasetError: Nothing is there to import.
        ConfigError: An episode of that id is there from something else, or scenes are missing.
    """
    jobs = plan_jobs(find_sources(source), config, config_folder or Path())
    episodes = run / fmt.EPISODES
    episodes.mkdir(parents=True, exist_ok=True)
    remove_partials(episodes)
    results: dict[str, ImportResult] = {}
    todo = []
    for job in jobs:
        if job.refusal:
            results[job.id] = ImportResult(job, "refused", job.refusal)
            yield results[job.id]
        elif (frames := _frames_there(episodes / job.id, job, config, overwrite)) is not None:
            results[job.id] = ImportResult(job, "kept", frames=frames)
            yield results[job.id]
        else:
            todo.append(_Task(job, run, config))
    for result in _work(todo, workers):
        results[result.job.id] = result
        yield result
    _report(config, [results[job.id] for job in jobs]).save(run / REPORT)


def _frames_there(folder: Path, job: Job, config: ImportConfig, overwrite: bool) -> int | None:
    """Frames of the episode if it is there already from the same job; None to make it."""
    if overwrite or not (folder / fmt.MANIFEST).is_file():
        return None
    manifest = load_manifest(folder)
    recording = manifest.recording
    same = (
        recording is not None
        and recording.config_sha256 == config_hash(config)
        and (recording.path, recording.segment) == (job.source.name, job.segment)
    )
    if not same:
        origin = "a simulation"
        if recording is not None:
            origin = f"{recording.path}#{recording.segment}, with another import.yaml"
        raise ConfigError(
            f"{folder}: an episode of this id is there, from {origin}; set first_id, choose "
            "another run folder, or give --overwrite"
        )
    return manifest.frames


def _work(tasks: Sequence[_Task], workers: int) -> Iterator[ImportResult]:
    if workers <= 1:
        opened = _Opened()
        try:
            for task in tasks:
                yield import_one(task.job, task.run, task.config, opened)
        finally:
            opened.close()
        return
    for outcome in run_tasks(_in_worker, tasks, workers=workers, timeout_s=TASK_TIMEOUT_S):
        if outcome.value is not None:
            yield outcome.value
        else:
            yield ImportResult(outcome.task.job, "refused", f"process: {outcome.reason}")


class _Opened:
    """The source that was opened last: segments of one recording follow each other."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._source: Recording | ArrayFile | None = None

    def get(self, path: Path) -> Recording | ArrayFile:
        if self._source is None or self._path != path:
            self.close()
            self._source, self._path = open_source(path), path
        return self._source

    def close(self) -> None:
        if self._source is not None:
            self._source.close()
        self._source = None


_opened_here = _Opened()
"""Of a worker process."""


def _in_worker(task: _Task) -> ImportResult:
    return import_one(task.job, task.run, task.config, _opened_here)


def import_one(job: Job, run: Path, config: ImportConfig, opened: _Opened) -> ImportResult:
    """Make one episode, or say why not."""
    start = time.monotonic()
    try:
        source = opened.get(job.source)
        if isinstance(source, ArrayFile):
            frames = _import_rows(source, job, run, config)
        else:
            frames = _import_bag(source, job, run, config)
    except (DatasetError, EpisodeError, ShapeError) as error:
        return ImportResult(job, "refused", str(error), seconds=time.monotonic() - start)
    return ImportResult(job, "imported", "", frames, time.monotonic() - start)


def _import_rows(source: ArrayFile, job: Job, run: Path, config: ImportConfig) -> int:
    steps = ArraySteps(source, job.episode, config)
    if steps.num_steps < config.limits.min_frames:
        raise DatasetError(f"{steps.num_steps} frames, below min_frames {config.limits.min_frames}")
    told = source.success(job.episode)
    success = job.success if told is None else told
    instruction = source.instruction(job.episode) or config.instruction
    damage = [*source.damage, *steps.notes]
    facts = episode_facts(
        job, config, success, instruction, steps, recording_record(source, job, config, damage)
    )
    return _write(run, job, facts, config, steps)


def _import_bag(source: Recording, job: Job, run: Path, config: ImportConfig) -> int:
    segment = Segment(job.start_ns, job.stop_ns, job.success)
    synced = synchronise(source, segment, config)
    if not len(synced.plan.frames_ns):
        raise DatasetError(refusal(synced, 0, config.limits) or "no frame is left")
    steps = BagSteps(source, synced, config)
    reason = refusal(synced, steps.num_steps, config.limits)
    if reason:
        raise DatasetError(reason)
    instruction = instruction_at(source, job, config) or config.instruction
    damage = [*source.damage, *synced.damage, *steps.notes]
    record = recording_record(source, job, config, damage, synced)
    facts = episode_facts(job, config, job.success, instruction, steps, record)
    return _write(run, job, facts, config, steps, synced)


def _write(
    run: Path,
    job: Job,
    facts: EpisodeFacts,
    config: ImportConfig,
    steps: BagSteps | ArraySteps,
    synced: SyncedEpisode | None = None,
) -> int:
    def arrays() -> Mapping[str, np.ndarray]:
        assert synced is not None
        return {name: a[: steps.num_steps] for name, a in synced.arrays().items()}

    manifest = write_episode(
        run / fmt.EPISODES / job.id,
        facts,
        steps.cameras,
        steps.steps(),
        hz=config.hz,
        image=config.image,
        joint_names=steps.joint_names,
        scene_file=job.scene,
        sync=arrays if synced is not None else None,
        records=steps.records,
    )
    return manifest.frames


def _report(config: ImportConfig, results: Sequence[ImportResult]) -> ImportReport:
    return ImportReport(
        config_sha256=config_hash(config),
        episodes=tuple(
            ImportedEpisode(
                id=r.job.id,
                recording=r.job.address,
                outcome="refused" if r.outcome == "refused" else "imported",
                reason=r.reason,
                frames=r.frames,
            )
            for r in results
        ),
    )
