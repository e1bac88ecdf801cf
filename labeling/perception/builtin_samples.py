"""Pictures that the built-in network learns from: drawn once, kept as files, cut out at random."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codediffuser.datagen.randomization import load_randomization
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.files import atomic_path
from codediffuser.labeling.perception.builtin_targets import make_targets, pixel_votes
from codediffuser.labeling.perception.rendered import Disturbance, StartRenderer
from codediffuser.labeling.perception.views import stack_views
from codediffuser.pointcloud import backproject_depth, inside_box
from codediffuser.seeding import Stage, rng_for

LOOKS = (None, "mild", "strong")
"""Presets of domain randomisation, drawn evenly; None is the usual look."""
REAL_SHARE = 3
"""One scene in so many is of the `real` variant."""
_DISTURBANCE = 1_000_000
"""Attempt number of the generator that draws looks and disturbances."""


@dataclass(frozen=True, slots=True)
class Sample:
    """All views of one scene with what their pixels show. Arrays lie in one file."""

    rgb: np.ndarray
    """(V, H, W, 3) uint8."""
    depth_m: np.ndarray
    """(V, H, W) float32."""
    K: np.ndarray
    """(V, 3, 3) float32."""
    T_world_camera: np.ndarray
    """(V, 4, 4) float32."""
    category: np.ndarray
    """(V, H, W) uint8, index into `CATEGORIES`."""
    votes: np.ndarray
    """(V, H, W, 3) float16 in units of `VOTE_SCALE`."""
    inside: np.ndarray
    """(V, H, W) bool: whether the point lies in the workspace."""

    @classmethod
    def load(cls, path: Path) -> Sample:
        """Read a file that `draw_samples` wrote."""
        with np.load(path) as stored:
            return cls(**{name: stored[name] for name in cls.__slots__})


def draw_samples(
    folder: Path, tasks: Sequence[str], scenes: Sequence[int], root_seed: int = 0
) -> Iterator[Path]:
    """Draw scenes that are not there yet, and yield the file of each scene as it is there.

    Args:
        folder: Made when missing.
        tasks: Names of tasks.
        scenes: Numbers of scenes, the same for each task.
        root_seed: Of all that is drawn.

    Raises:
        SetupError: There is no usable Vulkan device.
    """
    for name in tasks:
        renderer: StartRenderer | None = None
        for index in scenes:
            path = folder / f"{name}_{index:05d}.npz"
            if not path.exists():
                renderer = renderer or StartRenderer(get_task(name))
                sample = _draw(renderer, index, root_seed)
                with atomic_path(path) as partial:
                    np.savez(partial, **{n: getattr(sample, n) for n in Sample.__slots__})
            yield path


def _draw(renderer: StartRenderer, index: int, root_seed: int) -> Sample:
    task = renderer.task
    scene = sample_scene(
        task, root_seed=root_seed, index=index, stage=Stage.PERCEPTION,
        variant="sim" if index % REAL_SHARE else "real",
    )  # fmt: skip
    rng = rng_for(root_seed, Stage.PERCEPTION, index, _DISTURBANCE)
    preset = LOOKS[rng.integers(len(LOOKS))]
    ranges = load_randomization(preset) if preset else None
    start = renderer.draw(scene, ranges, Disturbance(), rng)
    images, depth_m, cameras = stack_views(start.views)
    targets = make_targets(task, start)
    inside = np.zeros(depth_m.shape, dtype=bool)
    low, high = np.array(task.config.workspace.low_m), np.array(task.config.workspace.high_m)
    for depth, camera, flat in zip(depth_m, cameras, inside.reshape(len(inside), -1), strict=True):
        points, pixel = backproject_depth(depth, camera.K, camera.T_world_camera)
        flat[pixel[inside_box(points, low, high)]] = True
    return Sample(
        rgb=images,
        depth_m=depth_m,
        K=np.stack([c.K for c in cameras]).astype(np.float32),
        T_world_camera=np.stack([c.T_world_camera for c in cameras]).astype(np.float32),
        category=np.concatenate([[0], targets.category]).astype(np.uint8)[targets.instance],
        votes=pixel_votes(start, targets).astype(np.float16),
        inside=inside,
    )
