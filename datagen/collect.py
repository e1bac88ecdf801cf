"""Scenes to episodes, in several processes, continued where an earlier call stopped."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.cameras import camera_parameters
from codediffuser.datagen.demo_results import (
    SUMMARY,
    DemoFailure,
    DemoResult,
    failure_path,
    summarize,
)
from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.record import DemoJob, PictureOptions, record_demo, rerender_episode
from codediffuser.datagen.workers import Outcome, run_tasks
from codediffuser.errors import ConfigError, EpisodeError
from codediffuser.files import remove_partials, sha256_file

SCENE_TIMEOUT_S = 600.0
"""Far above what a scene takes: a process that needs longer hangs."""

_log = logging.getLogger(__name__)


def scene_ids(run: Path) -> list[str]:
    """Ids of the scenes of a run, sorted.

    Raises:
        ConfigError: The run has no scenes.
    """
    ids = sorted(p.stem for p in (run / "scenes").glob("*.yaml") if not p.name.startswith("."))
    if not ids:
        raise ConfigError(f"{run / 'scenes'}: expected scene files, found none; run sample first")
    return ids


def collect_demos(
    run: Path,
    *,
    workers: int = 1,
    overwrite: bool = False,
    options: PictureOptions | None = None,
    timeout_s: float = SCENE_TIMEOUT_S,
) -> Iterator[DemoResult]:
    """Demonstrate every scene of a run that has no episode yet; write `demo_summary.json` last.

    First the scenes that earlier calls have settled are yielded, then new ones as they are done.
    Neither the number of processes nor an interruption changes what an episode holds.

    Args:
        run: Folder with `scenes/`; episodes go to `episodes/`.
        workers: How many processes.
        overwrite: Make whole episodes again, without their labels, and try failures again.
        options: Size, format and cameras of the pictures.
        timeout_s: After this time at one scene a process is taken to hang.

    Raises:
        ConfigError: There are no scenes, or one is damaged.
        EpisodeError: An episode was recorded from another scene than the one of its name.
        RenderError: A camera sees nothing of the workspace.
        SetupError: There is no Vulkan device.
    """
    started = time.monotonic()
    options = options or PictureOptions()
    jobs = [DemoJob(run, i, options, keep_labels=not overwrite) for i in scene_ids(run)]
    _remove_leftovers(run)
    settled = {} if overwrite else _settled(jobs)
    results = list(settled.values())
    yield from results
    waiting = [job for job in jobs if job.scene_id not in settled]
    for outcome in run_tasks(record_demo, waiting, workers=workers, timeout_s=timeout_s):
        result = _take_in(outcome)
        results.append(result)
        yield result
    # A killed run's processes may have outlived it for a moment, and left more.
    _remove_leftovers(run)
    summary = summarize(results, workers=workers, wall_s=time.monotonic() - started)
    summary.save(run / SUMMARY)


def rerender(
    run: Path,
    *,
    workers: int = 1,
    overwrite: bool = False,
    options: PictureOptions | None = None,
    timeout_s: float = SCENE_TIMEOUT_S,
) -> Iterator[DemoResult]:
    """Draw the pictures of every simulated episode again, from its stored states.

    States, scene and labels stay; log and manifest are replaced, folder by folder. Episodes whose
    pictures are as asked for are left alone unless `overwrite`, so a second call continues.

    Raises:
        EpisodeError: The run has no simulated episodes, or one is damaged.
    """
    options = options or PictureOptions()
    _remove_leftovers(run)
    episodes = [Episode.open(folder) for folder in list_episodes(run)]
    episodes = [e for e in episodes if fmt.STATES in e.manifest.files]
    if not episodes:
        raise EpisodeError(f"{run}: no episodes with simulator states; run demo first")
    jobs = []
    for episode in episodes:
        if not overwrite and _pictures_fit(episode, options):
            yield DemoResult.of_episode(episode.manifest, earlier=True)
        else:
            jobs.append(DemoJob(run, episode.folder.name, options))
    for outcome in run_tasks(rerender_episode, jobs, workers=workers, timeout_s=timeout_s):
        if outcome.value is None:
            raise EpisodeError(
                f"{outcome.task.folder}: no pictures after {outcome.tries} tries "
                f"({_last_line(outcome.error)}); the older ones are still there"
            )
        yield outcome.value


def _remove_leftovers(run: Path) -> None:
    """Delete what killed processes left half-written."""
    for folder in (run / fmt.EPISODES, failure_path(run, "").parent):
        for name in remove_partials(folder):
            _log.info("removed %s, left half-written by a killed process", folder / name)


def _settled(jobs: list[DemoJob]) -> dict[str, DemoResult]:
    """Scenes with a whole episode, or with a failure that would come again."""
    found: dict[str, DemoResult] = {}
    for job in jobs:
        result = _earlier_episode(job) or _earlier_failure(job)
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
        phase="process",
        reason=_last_line(outcome.error),
        tries=outcome.tries,
    )
    failure.save(path)
    return DemoResult.of_failure(failure)


def _pictures_fit(episode: Episode, options: PictureOptions) -> bool:
    """Whether an episode already has the pictures that are asked for."""
    wanted = options.camera_config(episode.manifest.task)
    poses = camera_parameters(wanted)
    if episode.manifest.image != options.image or set(poses) != set(episode.cameras):
        return False
    return all(
        (camera.width, camera.height) == (wanted.width, wanted.height)
        and np.allclose(camera.K, poses[name][0])
        and np.allclose(camera.T_world_camera, poses[name][1])
        for name, camera in episode.cameras.items()
    )


def _last_line(error: str) -> str:
    return error.rsplit("\n", 1)[-1]
