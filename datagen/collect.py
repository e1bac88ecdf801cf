"""Scenes to episodes, in several processes, continued where an earlier call stopped."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.appearance import Looks
from codediffuser.datagen.cameras import camera_parameters
from codediffuser.datagen.demo_results import (
    SUMMARY,
    DemoFailure,
    DemoResult,
    failure_path,
    summarize,
)
from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.physics_store import PHYSICS, load_physics
from codediffuser.datagen.pictures import PictureOptions, stored_appearance
from codediffuser.datagen.record import DemoJob, record_demo, rerender_episode
from codediffuser.datagen.scene import SCENES
from codediffuser.datagen.workers import Outcome, run_tasks
from codediffuser.errors import ConfigError, EpisodeError
from codediffuser.files import remove_partials, sha256_file

SCENE_TIMEOUT_S = 600.0
"""Far above what a scene takes: a process that needs longer hangs."""

RECYCLE_AFTER = 100
"""Scenes after which a process is replaced, since renderers leak."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class CollectOptions:
    """How scenes become episodes."""

    pictures: PictureOptions = field(default_factory=PictureOptions)
    """Size, format, cameras and looks of the pictures."""
    recovery: float = 0.0
    """Share of the demonstrations whose hand is pushed once; only for those made now."""
    physics_only: bool = False
    """Whether to look only for the scenes that the expert solves, without pictures."""
    overwrite: bool = False
    """Make whole episodes again, without their labels, and try failures again."""
    timeout_s: float = SCENE_TIMEOUT_S
    """After this time at one scene a process is taken to hang."""
    recycle_after: int = RECYCLE_AFTER
    """Scenes after which a process is replaced; 0 for never."""

    def job(self, run: Path, scene_id: str) -> DemoJob:
        """What a process is given for one scene."""
        return DemoJob(
            run, scene_id, self.pictures, keep_labels=not self.overwrite,
            recovery=self.recovery, physics_only=self.physics_only,
        )  # fmt: skip


def scene_ids(run: Path) -> list[str]:
    """Ids of the scenes of a run, sorted.

    Raises:
        ConfigError: The run has no scenes.
    """
    folder = run / SCENES
    ids = sorted(p.stem for p in folder.glob("*.yaml") if not p.name.startswith("."))
    if not ids:
        raise ConfigError(f"{folder}: expected scene files, found none; run sample first")
    return ids


def collect_demos(
    run: Path, options: CollectOptions | None = None, *, workers: int = 1
) -> Iterator[DemoResult]:
    """Demonstrate every scene of a run that has no episode yet; write `demo_summary.json` last.

    First the scenes that earlier calls have settled are yielded, then new ones as they are done.
    Neither the number of processes nor an interruption changes what an episode holds.

    Args:
        run: Folder with `scenes/`; episodes go to `episodes/`.
        options: How; None takes the usual.
        workers: How many processes.

    Raises:
        ConfigError: There are no scenes, or one is damaged.
        EpisodeError: An episode was recorded from another scene than the one of its name.
        RenderError: A camera sees nothing of the workspace.
        SetupError: There is no Vulkan device.
        StorageError: The disk is full.
    """
    started = time.monotonic()
    options = options or CollectOptions()
    jobs = [options.job(run, i) for i in scene_ids(run)]
    _remove_leftovers(run)
    settled = {} if options.overwrite else settled_scenes(jobs)
    results = list(settled.values())
    yield from results
    waiting = [job for job in jobs if job.scene_id not in settled]
    try:
        for result in record_scenes(waiting, options, workers=workers):
            results.append(result)
            yield result
    finally:
        # Processes that are killed, now or a moment ago, leave what they were writing.
        _remove_leftovers(run)
    summary = summarize(results, workers=workers, wall_s=time.monotonic() - started)
    summary.save(run / SUMMARY)


def record_scenes(
    jobs: Sequence[DemoJob], options: CollectOptions, *, workers: int = 1
) -> Iterator[DemoResult]:
    """Work off scenes in processes of their own; one that dies or hangs is a counted failure."""
    for outcome in _run(record_demo, jobs, options, workers):
        yield _take_in(outcome)


def simulated_episodes(run: Path) -> list[Episode]:
    """Episodes of a run that can be drawn again.

    Raises:
        EpisodeError: There are none, or one is damaged.
    """
    episodes = [Episode.open(folder) for folder in list_episodes(run)]
    episodes = [e for e in episodes if fmt.STATES in e.manifest.files]
    if not episodes:
        raise EpisodeError(f"{run}: no episodes with simulator states; run demo first")
    return episodes


def rerender(
    run: Path, options: CollectOptions | None = None, *, workers: int = 1
) -> Iterator[DemoResult]:
    """Draw the pictures of every simulated episode again, from its stored states.

    States, scene, push and labels stay; log, looks and manifest are replaced, folder by folder. The
    run needs no scene files. Episodes whose pictures are as asked for are left alone unless
    `overwrite`, so a second call continues.

    Raises:
        EpisodeError: The run has no simulated episodes, or one is damaged.
    """
    options = options or CollectOptions()
    _remove_leftovers(run)
    jobs = []
    for episode in simulated_episodes(run):
        if not options.overwrite and _pictures_fit(episode, options.pictures):
            yield DemoResult.of_episode(episode.manifest, earlier=True)
        else:
            jobs.append(DemoJob(run, episode.folder.name, options.pictures))
    try:
        for outcome in _run(rerender_episode, jobs, options, workers):
            if outcome.value is None:
                raise EpisodeError(
                    f"{outcome.task.folder}: no pictures after {outcome.tries} tries "
                    f"({outcome.reason}); the older ones are still there"
                )
            yield outcome.value
    finally:
        _remove_leftovers(run)


def _run(
    function: Callable[[DemoJob], DemoResult],
    jobs: Sequence[DemoJob],
    options: CollectOptions,
    workers: int,
) -> Iterator[Outcome[DemoJob, DemoResult]]:
    return run_tasks(
        function,
        jobs,
        workers=workers,
        timeout_s=options.timeout_s,
        recycle_after=options.recycle_after,
    )


def _remove_leftovers(run: Path) -> None:
    """Delete what killed processes left half-written."""
    for folder in (run / fmt.EPISODES, failure_path(run, "").parent, run / PHYSICS):
        for name in remove_partials(folder):
            _log.info("removed %s, left half-written by a killed process", folder / name)


def settled_scenes(jobs: Sequence[DemoJob]) -> dict[str, DemoResult]:
    """Scenes with a whole episode, or with a failure that would come again.

    Raises:
        EpisodeError: An episode was recorded from another scene than the one of its name.
    """
    found: dict[str, DemoResult] = {}
    for job in jobs:
        result = _earlier_episode(job) or _earlier_failure(job) or _earlier_physics(job)
        if result is not None:
            found[job.scene_id] = result
    return found


def _earlier_episode(job: DemoJob) -> DemoResult | None:
    if not job.folder.exists():
        return None
    try:
        episode = Episode.open(job.folder)
    except EpisodeError as error:
        _log.warning("%s: made again, labels are kept", error)
        return None
    if episode.manifest.files[fmt.SCENE].sha256 != sha256_file(job.scene_file):
        raise EpisodeError(
            f"{job.folder}: was recorded from another scene than {job.scene_file}; choose another "
            "run folder, or pass --overwrite to make the episodes of this run again"
        )
    return DemoResult.of_episode(episode.manifest, earlier=True)


def _earlier_failure(job: DemoJob) -> DemoResult | None:
    path = failure_path(job.run, job.scene_id)
    if not path.is_file():
        return None
    failure = DemoFailure.load(path)
    if not failure.repeatable or failure.scene_sha256 != sha256_file(job.scene_file):
        return None
    return DemoResult.of_failure(failure, earlier=True)


def _earlier_physics(job: DemoJob) -> DemoResult | None:
    """States that wait for pictures settle a scene when no pictures are asked for."""
    if not job.physics_only:
        return None
    physics = load_physics(job.run, job.scene_id, job.recovery)
    if physics is None:
        return None
    return DemoResult.of_physics(job.scene_id, physics.trajectory.num_steps, earlier=True)


def _take_in(outcome: Outcome[DemoJob, DemoResult]) -> DemoResult:
    """Turn what came of a scene's process into a result, and keep the failure record up to date."""
    job, result = outcome.task, outcome.value
    path = failure_path(job.run, job.scene_id)
    if result is not None:
        if result.success:
            path.unlink(missing_ok=True)
        return result
    failure = DemoFailure(
        scene_id=job.scene_id,
        scene_sha256=sha256_file(job.scene_file),
        cause="process",
        phase=f"process:{outcome.fate}",
        reason=outcome.reason,
        tries=outcome.tries,
    )
    failure.save(path)
    return DemoResult.of_failure(failure)


def _pictures_fit(episode: Episode, options: PictureOptions) -> bool:
    """Whether an episode already has the pictures that are asked for."""
    stored = stored_appearance(episode)
    wanted_looks = options.appearance(episode.scene, episode.trajectory, stored)
    if wanted_looks != stored or episode.manifest.image != options.image:
        return False
    config = options.camera_config(episode.manifest.task)
    poses = camera_parameters((stored.looks if stored else Looks()).move_cameras(config))
    if set(poses) != set(episode.cameras):
        return False
    return all(
        (camera.width, camera.height) == (config.width, config.height)
        and np.allclose(camera.K, poses[name][0])
        and np.allclose(camera.T_world_camera, poses[name][1])
        for name, camera in episode.cameras.items()
    )
