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
import tyro
from mani_skill.envs.tasks.tabletop.pick_cube import PickCubeEnv
from mani_skill.sensors.camera import CameraConfig as ManiSkillCamera

from codediffuser.datagen.cameras import T_world_camera, sapien_camera_pose
from codediffuser.datagen.envs import physics_env
from codediffuser.datagen.rendering import Renderer
from codediffuser.datagen.robot import base_pose
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.script import ExpertRun, run_expert
from codediffuser.datagen.task import Task, get_task
from codediffuser.datagen.views import moment_at
from codediffuser.errors import BelowTargetError

TARGET_RATIO = 5.0
PICK_CUBE_BASE = sapien.Pose([-0.615, 0.0, 0.0])
"""Where PickCube's robot stands; cameras keep their place relative to the robot."""


@dataclasses.dataclass(frozen=True, slots=True)
class BenchResult:
    """What a run measured."""

    pictures: str
    """How many pictures of which size make a set."""
    ours_s: float
    """Median seconds of one set of pictures in our rendering phase."""
    stock_s: float
    """Median seconds of one step of stock ManiSkill with the same cameras."""
    ratio: float
    """Median over rounds of stock / ours within one round."""
    steps_per_s: float
    """Control steps per second of the physics phase, without resets."""
    episodes_per_min: float
    """Whole scripted demonstrations per minute, resets included."""


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
    task: str = "pack_battery",
    *,
    width: int = 160,
    height: int = 120,
    rounds: int = 12,
    sets_per_round: int = 5,
    episodes: int = 5,
) -> BenchResult:
    """Measure both phases; takes about a minute on two free cores.

    Args:
        task: Registered task whose cameras and scenes are used.
        width: Of each picture, pixels.
        height: Of each picture, pixels.
        rounds: How often the two renderers take turns.
        sets_per_round: Sets of pictures in one turn.
        episodes: Demonstrations of the physics phase.
    """
    chosen = get_task(task)
    runs, steps_per_s, episodes_per_min = _measure_physics(chosen, episodes)
    trajectory = runs[0].trajectory
    size = {"width": width, "height": height}
    renderer = Renderer(chosen, chosen.config.cameras.model_copy(update=size))
    renderer.set_scene(runs[0].scene)
    stock = stock_env(chosen, width, height)
    stock.reset(seed=0)
    action = np.zeros(stock.action_space.shape, dtype=np.float32)
    moments = _endless(trajectory.num_steps)

    def ours() -> None:
        renderer.render(moment_at(trajectory, next(moments)))

    def theirs() -> None:
        stock.step(action)

    pairs = list(_interleaved(ours, theirs, rounds, sets_per_round))
    stock.close()
    return BenchResult(
        pictures=f"{len(renderer.parameters)} x {width}x{height}",
        ours_s=statistics.median(a for a, _ in pairs),
        stock_s=statistics.median(b for _, b in pairs),
        ratio=statistics.median(b / a for a, b in pairs),
        steps_per_s=steps_per_s,
        episodes_per_min=episodes_per_min,
    )


def _measure_physics(task: Task, episodes: int) -> tuple[list[ExpertRun], float, float]:
    """Demonstrations, control steps/s without resets, episodes/min with them (medians)."""
    scenes = [sample_scene(task, root_seed=0, index=i) for i in range(episodes)]
    env = physics_env(task, scenes[0])
    runs, whole_s = [], []
    for i, scene in enumerate(scenes):
        began = time.perf_counter()
        runs.append(run_expert(env, scene, np.random.default_rng(i)))
        whole_s.append(time.perf_counter() - began)
    stepping_s = []
    for run in runs:
        env.reset(options={"scene": run.scene})
        began = time.perf_counter()
        for action in run.trajectory.actions:
            env.control_step(action)
        stepping_s.append((time.perf_counter() - began) / run.trajectory.num_steps)
    return runs, 1 / statistics.median(stepping_s), 60 / statistics.median(whole_s)


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
    rows = [
        (f"rendering phase, {result.pictures}", 1 / result.ours_s, "sets/s"),
        ("stock ManiSkill PickCube-v1, same cameras", 1 / result.stock_s, "sets/s"),
        ("ratio", result.ratio, f"x (target {TARGET_RATIO:g}: {verdict})"),
        ("physics phase, stepping alone", result.steps_per_s, "control steps/s"),
        ("physics phase, whole demonstrations", result.episodes_per_min, "episodes/min"),
    ]
    return "\n".join(f"{name:42s} {value:8.1f} {unit}" for name, value, unit in rows)


def main() -> int:
    """Print the measurements; 3 when the ratio is below its target."""
    result = tyro.cli(run_bench)
    sys.stdout.write(report(result) + "\n")
    return 0 if result.ratio >= TARGET_RATIO else BelowTargetError.exit_code


if __name__ == "__main__":
    raise SystemExit(main())
