"""The rendering phase: pictures of stored states, and the episode folder around them."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.appearance import APPEARANCE, Appearance, Looks, SensorErrors
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_format import Camera, EpisodeManifest, ImageOptions
from codediffuser.datagen.episode_writer import EpisodeFacts, write_episode
from codediffuser.datagen.log_step import Pictures, trajectory_steps
from codediffuser.datagen.randomization import Randomization, draw_appearance
from codediffuser.datagen.recovery import RECOVERY, Recovery
from codediffuser.datagen.scene import SceneSpec, SeedKey
from codediffuser.datagen.sensor_errors import sensor_rng, spoil_color, spoil_depth
from codediffuser.datagen.task import get_task
from codediffuser.datagen.task_config import CameraConfig
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.datagen.views import moment_at
from codediffuser.schema import Strict

if TYPE_CHECKING:
    from codediffuser.datagen.rendering import Frame, Renderer


class NamedRanges(Strict):
    """Ranges of randomisation, and what they are called."""

    name: str
    ranges: Randomization


class PictureOptions(Strict):
    """Which pictures an episode gets."""

    width: int | None = None
    """Pixels; None takes the task's."""
    height: int | None = None
    image: ImageOptions = ImageOptions()
    cameras: CameraConfig | None = None
    """Other cameras than the task's."""
    looks: NamedRanges | Literal["stored", "usual"] = "stored"
    """`stored`: as the episode has them already, the usual look for a new one."""

    def camera_config(self, task_name: str) -> CameraConfig:
        """Cameras of a task with these options applied, where the task's YAML puts them."""
        config = self.cameras or get_task(task_name).config.cameras
        return config.model_copy(
            update={"width": self.width or config.width, "height": self.height or config.height}
        )

    def appearance(
        self, scene: SceneSpec, trajectory: Trajectory, stored: Appearance | None
    ) -> Appearance | None:
        """What an episode shall look like; None is the usual look."""
        if isinstance(self.looks, NamedRanges):
            task = get_task(scene.task)
            return draw_appearance(self.looks.ranges, self.looks.name, task, scene, trajectory)
        return stored if self.looks == "stored" else None


@dataclass(frozen=True, slots=True)
class PictureTimes:
    """Where the time of an episode's rendering phase went, seconds."""

    render_s: float
    write_s: float
    """Spoiling, compressing, writing and reading back."""


def draw_and_write(
    folder: Path,
    options: PictureOptions,
    facts: EpisodeFacts,
    scene: SceneSpec,
    trajectory: Trajectory,
    *,
    scene_file: Path,
    appearance: Appearance | None,
    recovery: Recovery | None,
    keep: tuple[Path, ...] = (),
) -> tuple[EpisodeManifest, PictureTimes]:
    """Draw an episode's pictures from its states and write its folder, whole or not at all.

    Args:
        folder: `RUN/episodes/<id>`.
        options: Size, format and cameras of the pictures.
        facts: What the manifest says.
        scene: What was reset to.
        trajectory: Its states.
        scene_file: The scene's file, copied.
        appearance: What it looks like; None is the usual look.
        recovery: The push, if there was one.
        keep: Files that are copied along and not listed.
    """
    config = options.camera_config(scene.task)
    looks = appearance.looks if appearance else Looks()
    renderer = _renderer(scene.task, config.model_dump_json())
    renderer.set_scene(scene, looks)
    cameras = {
        name: Camera(K, T, config.width, config.height)
        for name, (K, T) in renderer.parameters.items()
    }
    documents = {APPEARANCE: appearance, RECOVERY: recovery}
    clock = _Clock()
    started = time.perf_counter()
    manifest = write_episode(
        folder,
        facts,
        cameras,
        trajectory_steps(trajectory, _pictures(renderer, looks, scene.seed, trajectory, clock)),
        image=options.image,
        scene_file=scene_file,
        trajectory=trajectory,
        documents={name: document for name, document in documents.items() if document},
        keep=keep,
    )
    write_s = time.perf_counter() - started - clock.seconds
    return manifest, PictureTimes(clock.seconds, write_s)


@dataclass(slots=True)
class _Clock:
    """Adds up the time of one kind of work that is interleaved with another."""

    seconds: float = 0.0


def _pictures(
    renderer: Renderer, looks: Looks, seed: SeedKey, trajectory: Trajectory, clock: _Clock
) -> Iterator[Pictures]:
    """Draw every moment but the last, after which nothing is commanded."""
    for k in range(trajectory.num_steps):
        started = time.perf_counter()
        frames = renderer.render(moment_at(trajectory, k))
        clock.seconds += time.perf_counter() - started
        yield _sensed(frames, looks.sensor, seed, k)


def _sensed(
    frames: Mapping[str, Frame], errors: SensorErrors | None, seed: SeedKey, k: int
) -> Pictures:
    """Frames as the sensors of the episode give them."""
    rgb, depth_mm = {}, {}
    for number, (name, frame) in enumerate(frames.items()):
        color, depth_m = frame.rgb, frame.depth_m
        if errors is not None:
            rng = sensor_rng(seed, k, number)
            color, depth_m = spoil_color(color, errors, rng), spoil_depth(depth_m, errors, rng)
        rgb[name], depth_mm[name] = color, depth_to_mm(depth_m)
    return Pictures(rgb=rgb, depth_mm=depth_mm)


def depth_to_mm(depth_m: np.ndarray) -> np.ndarray:
    """Round depth (H, W) in metres to whole millimetres (H, W) uint16; beyond 65 m it saturates."""
    return np.clip(np.rint(depth_m * 1000), 0, 65535).astype(np.uint16)


def stored_appearance(episode: Episode) -> Appearance | None:
    """What an episode looks like; None is the usual look."""
    if APPEARANCE not in episode.manifest.files:
        return None
    return Appearance.load(episode.folder / APPEARANCE)


def stored_recovery(episode: Episode) -> Recovery | None:
    """How an episode's hand was pushed; None when it was not."""
    if RECOVERY not in episode.manifest.files:
        return None
    return Recovery.load(episode.folder / RECOVERY)


def unlisted_files(folder: Path) -> tuple[Path, ...]:
    """Files of an episode folder that were not written with it, such as labels."""
    own = {fmt.LOG, fmt.SCENE, fmt.STATES, fmt.MANIFEST, APPEARANCE, RECOVERY}
    return tuple(sorted(p for p in folder.glob("*") if p.is_file() and p.name not in own))


@functools.lru_cache(maxsize=1)
def _renderer(task_name: str, config_json: str) -> Renderer:
    """The process's renderer for one set of cameras (as JSON, which can be compared)."""
    from codediffuser.datagen.rendering import Renderer

    return Renderer(get_task(task_name), CameraConfig.model_validate_json(config_json))
