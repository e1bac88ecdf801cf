"""Makes one episode: physics first, then pictures of the stored states, then the folder.

These functions run in worker processes, which keep one simulator and one renderer each.
"""

from __future__ import annotations

import functools
import os
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.demo_results import (
    DemoFailure,
    DemoResult,
    failure_path,
    resident_mb,
)
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_format import ConditionRecord
from codediffuser.datagen.episode_writer import EpisodeFacts
from codediffuser.datagen.physics_store import (
    Physics,
    forget_physics,
    load_physics,
    save_physics,
)
from codediffuser.datagen.pictures import (
    PictureOptions,
    draw_and_write,
    stored_appearance,
    stored_recovery,
    unlisted_files,
)
from codediffuser.datagen.recovery import draw_push, recovery_record
from codediffuser.datagen.scene import SceneSpec, scene_path
from codediffuser.datagen.task import Check, get_task
from codediffuser.errors import ConfigError
from codediffuser.files import partial_path, sha256_file
from codediffuser.seeding import Stage, rng_for

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.script import ExpertRun


@dataclass(frozen=True, slots=True)
class DemoJob:
    """One scene to demonstrate, or one episode to draw again."""

    run: Path
    scene_id: str
    options: PictureOptions
    keep_labels: bool = True
    """Whether labels in an older folder of the episode come along."""
    recovery: float = 0.0
    """Chance that the hand is pushed once."""
    physics_only: bool = False
    """Whether to stop before the pictures."""

    @property
    def scene_file(self) -> Path:
        """The scene in its run."""
        return scene_path(self.run, self.scene_id)

    @property
    def folder(self) -> Path:
        """The episode of the scene."""
        return self.run / fmt.EPISODES / self.scene_id


def record_demo(job: DemoJob) -> DemoResult:
    """Let the scripted expert solve a scene and write the episode, or record why it failed.

    The result depends on the scene file and the job's settings alone, not on what the process did
    before. States that an earlier physics phase has stored are drawn, not simulated again.
    """
    scene = _load_scene(job)
    physics, physics_s = load_physics(job.run, job.scene_id, job.recovery), 0.0
    if physics is None:
        started = time.perf_counter()
        done = _demonstrate(scene, job.recovery)
        physics_s = time.perf_counter() - started
        if not done.success:
            remove_folder(job.folder)
            failure = _failure(job, done)
            failure.save(failure_path(job.run, job.scene_id))
            return DemoResult.of_failure(failure, physics_s=physics_s, rss_mb=resident_mb())
        physics = _physics(scene, done, job.recovery)
        if job.physics_only:
            save_physics(job.run, job.scene_id, physics, job.recovery)
    if job.physics_only:
        steps = physics.trajectory.num_steps
        return DemoResult.of_physics(job.scene_id, steps, physics_s=physics_s, rss_mb=resident_mb())
    result = _write_demo(job, scene, physics, physics_s)
    forget_physics(job.run, job.scene_id)
    return result


def rerender_episode(job: DemoJob) -> DemoResult:
    """Draw the pictures of an episode again from its stored states; all else stays.

    Raises:
        EpisodeError: The episode is damaged, or has no simulator states.
    """
    episode = Episode.open(job.folder, verify=True)
    manifest = episode.manifest
    facts = EpisodeFacts(
        id=manifest.id,
        task=manifest.task,
        source=manifest.source,
        instruction=manifest.instruction,
        success=manifest.success,
        seed=manifest.seed,
        reason=manifest.reason,
        conditions=manifest.conditions,
    )
    stored = stored_appearance(episode)
    made, times = draw_and_write(
        job.folder,
        job.options,
        facts,
        episode.scene,
        episode.trajectory,
        scene_file=job.folder / fmt.SCENE,
        appearance=job.options.appearance(episode.scene, episode.trajectory, stored),
        recovery=stored_recovery(episode),
        keep=unlisted_files(job.folder),
    )
    return DemoResult.of_episode(
        made, render_s=times.render_s, write_s=times.write_s, rss_mb=resident_mb()
    )


def _load_scene(job: DemoJob) -> SceneSpec:
    scene = SceneSpec.load(job.scene_file)
    if scene.scene_id != job.scene_id:
        raise ConfigError(
            f"{job.scene_file}: expected scene_id '{job.scene_id}' as its name says, got "
            f"'{scene.scene_id}'; rename the file or change the entry"
        )
    return scene


def _demonstrate(scene: SceneSpec, recovery: float) -> ExpertRun:
    from codediffuser.datagen.script import run_expert

    rng = rng_for(scene.seed.root, Stage.EXPERT, scene.seed.index)
    push = draw_push(get_task(scene.task), scene.seed, recovery)
    return run_expert(_simulator(scene.task), scene, rng, push)


def _physics(scene: SceneSpec, done: ExpertRun, probability: float) -> Physics:
    record = None
    push = draw_push(get_task(scene.task), scene.seed, probability)
    # A script may have no move that the push fits.
    if push is not None and done.pushed_at is not None:
        record = recovery_record(scene.seed, probability, push, done.pushed_at)
    return Physics(done.trajectory, condition_records(done.check), record)


def _write_demo(job: DemoJob, scene: SceneSpec, physics: Physics, physics_s: float) -> DemoResult:
    facts = EpisodeFacts(
        id=scene.scene_id,
        task=scene.task,
        source="simulation",
        instruction=scene.instruction.text,
        success=True,
        seed=scene.seed,
        conditions=physics.conditions,
    )
    manifest, times = draw_and_write(
        job.folder,
        job.options,
        facts,
        scene,
        physics.trajectory,
        scene_file=job.scene_file,
        appearance=job.options.appearance(scene, physics.trajectory, None),
        recovery=physics.recovery,
        keep=unlisted_files(job.folder) if job.keep_labels else (),
    )
    return DemoResult.of_episode(
        manifest,
        physics_s=physics_s,
        render_s=times.render_s,
        write_s=times.write_s,
        rss_mb=resident_mb(),
    )


def condition_records(check: Check) -> tuple[ConditionRecord, ...]:
    """Conditions of a check as a manifest holds them."""
    return tuple(
        ConditionRecord(name=c.name, value=c.value, threshold=c.threshold, holds=c.holds)
        for c in check.conditions
    )


def remove_folder(folder: Path) -> None:
    """Delete a folder so that a kill meanwhile leaves no half of it under its name."""
    if folder.exists():
        doomed = partial_path(folder)
        os.replace(folder, doomed)
        shutil.rmtree(doomed)


def _failure(job: DemoJob, done: ExpertRun) -> DemoFailure:
    return DemoFailure(
        scene_id=job.scene_id,
        scene_sha256=sha256_file(job.scene_file),
        cause="expert",
        phase=done.failure_phase,
        reason=done.failure_reason,
        conditions=condition_records(done.check),
        steps=done.trajectory.num_steps,
    )


@functools.lru_cache(maxsize=1)
def _simulator(task_name: str) -> SceneEnv:
    """The process's simulator; its environment is reset to every scene in full."""
    from codediffuser.datagen.envs import physics_env

    return physics_env(task_name)
