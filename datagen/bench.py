"""Measures the rendering phase against stock ManiSkill, and the physics phase: `make bench`.

Both renderers take turns in one process, so that whatever else the machine does hits both alike;
only the ratio is worth quoting.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import sapien
from mani_skill.envs.tasks.tabletop.pick_cube import PickCubeEnv
from mani_skill.sensors.camera import CameraConfig as ManiSkillCamera

from codediffuser.datagen.cameras import T_world_camera, sapien_camera_pose
from codediffuser.datagen.envs import physics_env
from codediffuser.datagen.rendering import Renderer
from codediffuser.datagen.robot import base_pose
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.script import run_expert
from codediffuser.datagen.task import Task, get_task
from codediffuser.datagen.views import moment_at

TARGET_RATIO = 5.0
PICK_CUBE_BASE = sapien.Pose([-0.615, 0.0, 0.0])
"""Where PickCube's robot stands; cameras keep their place relative to the robot."""


@dataclasses.dataclass(frozen=True, slots=True)
class BenchResult:
    """What a run measured."""

    ours_s: float
    """Median seconds of one set of pictures in our rendering phase."""
    stock_s: float
    """Median seconds of one step of stock ManiSkill with the same cameras."""
    ratio: float
    """Median over rounds of stock / ours within one round."""
    steps_per_s: float
    """Control steps per second of the physics phase, resets included."""


def stock_env(task: Task, width: int, height: int) -> Any:
    """ManiSkill's PickCube as it comes, with this task's cameras in place of its own."""
    cameras = task.config.cameras
    move = PICK_CUBE_BASE * base_pose(task.config.robot).inv()

    class PickCubeManyCameras(PickCubeEnv):
        @property
        def _default_sensor_configs(self) -> list[ManiSkillCamera]:
            return [
                ManiSkillCamera(
                    uid=view.name,
                    pose=move * sapien_camera_pose(T_world_camera(view)),
                    width=width,
                    height=height,
                    fov=cameras.fov_y_rad,
                    near=cameras.near_m,
                    far=cameras.far_m,
                )
                for view in cameras.views
            ]

    return PickCubeManyCameras(
        obs_mode="rgb+depth+segmentation", sim_backend="physx_cpu", render_backend="cpu"
    )


def run_bench(
    task_name: str = "pack_battery",
    *,
    width: int = 160,
    height: int = 120,
    rounds: int = 12,
    sets_per_round: int = 5,
) -> BenchResult:
    """Measure both phases; takes about a minute on two cores."""
    task = get_task(task_name)
    scene = sample_scene(task, root_seed=0, index=0)
    env = physics_env(task, scene)
    began = time.perf_counter()
    run = run_expert(env, scene, np.random.default_rng(0))
    steps_per_s = run.trajectory.num_steps / (time.perf_counter() - began)

    size = {"width": width, "height": height}
    renderer = Renderer(task, task.config.cameras.model_copy(update=size))
    renderer.set_scene(scene)
    stock = stock_env(task, width, height)
    stock.reset(seed=0)
    action = np.zeros(stock.action_space.shape, dtype=np.float32)
    moments = _endless(run.trajectory.num_steps)

    def ours() -> None:
        renderer.render(moment_at(run.trajectory, next(moments)))

    def theirs() -> None:
        stock.step(action)

    pairs = list(_interleaved(ours, theirs, rounds, sets_per_round))
    stock.close()
    return BenchResult(
        ours_s=statistics.median(a for a, _ in pairs),
        stock_s=statistics.median(b for _, b in pairs),
        ratio=statistics.median(b / a for a, b in pairs),
        steps_per_s=steps_per_s,
    )


def _endless(count: int) -> Iterator[int]:
    while True:
        yield from range(count)


def _interleaved(
    first: Callable[[], None], second: Callable[[], None], rounds: int, repeats: int
) -> Iterator[tuple[float, float]]:
    """Yield seconds per call of both, round by round; the first round only warms up."""
    for number in range(rounds + 1):
        taken = []
        for call in (first, second):
            began = time.perf_counter()
            for _ in range(repeats):
                call()
            taken.append((time.perf_counter() - began) / repeats)
        if number > 0:
            yield taken[0], taken[1]


def report(result: BenchResult) -> str:
    """The measurements in words."""
    verdict = "reached" if result.ratio >= TARGET_RATIO else "MISSED"
    return "\n".join(
        [
            f"five cameras at 160x120, rendering phase : {1 / result.ours_s:7.1f} sets/s "
            f"({result.ours_s * 1e3:.1f} ms)",
            f"stock ManiSkill PickCube-v1, same cameras: {1 / result.stock_s:7.1f} sets/s "
            f"({result.stock_s * 1e3:.1f} ms)",
            f"ratio                                    : {result.ratio:7.2f} x "
            f"(target {TARGET_RATIO:g}: {verdict})",
            f"physics phase, one process               : {result.steps_per_s:7.0f} control steps/s",
        ]
    )


def main() -> int:
    """Print the measurements; 3 when the ratio is below its target."""
    result = run_bench()
    sys.stdout.write(report(result) + "\n")
    return 0 if result.ratio >= TARGET_RATIO else 3


if __name__ == "__main__":
    raise SystemExit(main())
