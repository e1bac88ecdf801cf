"""Makes one episode: physics first, then pictures of the stored states, then the folder.

These functions run in worker processes, which keep one simulator and one renderer each.
"""

from __future__ import annotations

import functools
import os
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.demo_results import DemoFailure, DemoResult, failure_path
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_format import Camera, ConditionRecord, ImageOptions
from codediffuser.datagen.episode_writer import (
    EpisodeFacts,
    Pictures,
    trajectory_steps,
    write_episode,
)
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import CameraConfig, Check, get_task
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.datagen.views import moment_at
from codediffuser.errors import ConfigError
from codediffuser.files import TEMPORARY_PREFIX, sha256_file
from codediffuser.seeding import Stage, rng_for

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.rendering import Renderer
    from codediffuser.datagen.script import ExpertRun


@dataclass(frozen=True, slots=True)
class PictureOptions:
    """Which pictures an episode gets."""

    width: int | None = None
    """Pixels; None takes the task's."""
    height: int | None = None
    image: ImageOptions = field(default_factory=ImageOptions)
    cameras: CameraConfig | None = None
    """Other cameras than the task's."""

    def camera_config(self, task_name: str) -> CameraConfig:
        """Cameras of a task with these options applied."""
        config = self.cameras or get_task(task_name).config.cameras
        return config.model_copy(
            update={"width": self.width or config.width, "height": self.height or config.height}
        )


@dataclass(frozen=True, slots=True)
class DemoJob:
    """One scene to demonstrate, or one episode to draw again."""

    run: Path
    scene_id: str
    options: PictureOptions
    keep_labels: bool = True
    """Whether labels in an older folder of the episode come along."""

    @property
    def scene_file(self) -> Path:
        """The scene in its run."""
        return self.run / "scenes" / f"{self.scene_id}.yaml"

    @property
    def folder(self) -> Path:
        """The episode of the scene."""
        return self.run / fmt.EPISODES / self.scene_id


def record_demo(job: DemoJob) -> DemoResult:
    """Let the scripted expert solve a scene and write the episode, or record why it failed.

    The result depends on the scene file alone, not on what the process did before.
    """
    from codediffuser.datagen.script import run_expert

    scene = SceneSpec.load(job.scene_file)
    if scene.scene_id != job.scene_id:
        raise ConfigError(
            f"{job.scene_file}: expected scene_id '{job.scene_id}' as its name says, got "
            f"'{scene.scene_id}'; rename the file or change the entry"
        )
    env = _simulator(scene.task)
    rng = rng_for(scene.seed.root, Stage.EXPERT, scene.seed.index)
    started = time.perf_counter()
    done = run_expert(env, scene, rng)
    physics_s = time.perf_counter() - started
    if not done.success:
        remove_folder(job.folder)
        failure = _failure(job, done)
        failure.save(failure_path(job.run, job.scene_id))
        return DemoResult.of_failure(failure, physics_s=physics_s)
    facts = EpisodeFacts(
        id=scene.scene_id,
        task=scene.task,
        source="simulation",
        instruction=scene.instruction.text,
        success=True,
        seed=scene.seed,
        conditions=condition_records(done.check),
    )
    return _draw_and_write(job, scene, job.scene_file, done.trajectory, facts, physics_s)


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
    scene_file = job.folder / fmt.SCENE
    return _draw_and_write(job, episode.scene, scene_file, episode.trajectory, facts, 0.0)


def _draw_and_write(
    job: DemoJob,
    scene: SceneSpec,
    scene_file: Path,
    trajectory: Trajectory,
    facts: EpisodeFacts,
    physics_s: float,
) -> DemoResult:
    config = job.options.camera_config(scene.task)
    renderer = _renderer(scene.task, config.model_dump_json())
    cameras = {
        name: Camera(K, T, config.width, config.height)
        for name, (K, T) in renderer.parameters.items()
    }
    clock = _Clock()
    started = time.perf_counter()
    manifest = write_episode(
        job.folder,
        facts,
        cameras,
        trajectory_steps(trajectory, _pictures(renderer, scene, trajectory, clock)),
        image=job.options.image,
        scene_file=scene_file,
        trajectory=trajectory,
        keep=unlisted_files(job.folder) if job.keep_labels else (),
    )
    write_s = time.perf_counter() - started - clock.seconds
    return DemoResult.of_episode(
        manifest, physics_s=physics_s, render_s=clock.seconds, write_s=write_s
    )


@dataclass(slots=True)
class _Clock:
    """Adds up the time of one kind of work that is interleaved with another."""

    seconds: float = 0.0


def _pictures(
    renderer: Renderer, scene: SceneSpec, trajectory: Trajectory, clock: _Clock
) -> Iterator[Pictures]:
    """Draw every moment but the last, after which nothing is commanded."""
    renderer.set_scene(scene)
    for k in range(trajectory.num_steps):
        started = time.perf_counter()
        frames = renderer.render(moment_at(trajectory, k))
        clock.seconds += time.perf_counter() - started
        yield Pictures(
            rgb={name: f.rgb for name, f in frames.items()},
            depth_mm={name: depth_to_mm(f.depth_m) for name, f in frames.items()},
        )


def depth_to_mm(depth_m: np.ndarray) -> np.ndarray:
    """Round depth (H, W) in metres to whole millimetres (H, W) uint16; beyond 65 m it saturates."""
    return np.clip(np.rint(depth_m * 1000), 0, 65535).astype(np.uint16)


def condition_records(check: Check) -> tuple[ConditionRecord, ...]:
    """Conditions of a check as a manifest holds them."""
    return tuple(
        ConditionRecord(name=c.name, value=c.value, threshold=c.threshold, holds=c.holds)
        for c in check.conditions
    )


def unlisted_files(folder: Path) -> list[Path]:
    """Files of an episode folder that were not written with it, such as labels."""
    own = {fmt.LOG, fmt.SCENE, fmt.STATES, fmt.MANIFEST}
    return sorted(p for p in folder.glob("*") if p.is_file() and p.name not in own)


def remove_folder(folder: Path) -> None:
    """Delete a folder so that a kill meanwhile leaves no half of it under its name."""
    if folder.exists():
        doomed = folder.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-old-{folder.name}")
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
    import gymnasium

    from codediffuser.datagen.envs import env_id

    env = gymnasium.make(env_id(task_name), render_backend="none", obs_mode="none")
    return env.unwrapped  # type: ignore[return-value]


@functools.lru_cache(maxsize=1)
def _renderer(task_name: str, config_json: str) -> Renderer:
    """The process's renderer for one set of cameras (as JSON, which can be compared)."""
    from codediffuser.datagen.rendering import Renderer

    return Renderer(get_task(task_name), CameraConfig.model_validate_json(config_json))
