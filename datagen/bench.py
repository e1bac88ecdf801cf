"""Measures recording: pictures against stock ManiSkill, physics, whole demonstrations.

Run it by `make bench`. Both renderers take turns in one process, so that whatever else the machine
does hits both alike; only the ratio is worth quoting. Scenes are whole ones of the task, the robot
moves as recorded.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tyro

import codediffuser.datagen.tasks  # noqa: F401  fills TASKS
from codediffuser.datagen.task import TASKS, Task, get_task
from codediffuser.datagen.workers import run_tasks
from codediffuser.errors import BelowTargetError, NotRegisteredError, SetupError
from codediffuser.registry import unknown_name

TARGETS = {(160, 120): 7.0, (320, 240): 4.0}
"""Times faster than stock ManiSkill, by width and height of the pictures."""


@dataclasses.dataclass(frozen=True, slots=True)
class BenchCase:
    """What one process measures."""

    task: str
    width: int
    height: int
    rounds: int
    sets_per_round: int
    episodes: int


@dataclasses.dataclass(frozen=True, slots=True)
class BenchResult:
    """What came of a case."""

    case: BenchCase
    cameras: int
    ours_s: float
    """Median seconds of one set of pictures in our rendering phase."""
    stock_s: float
    """Median seconds of one step of stock ManiSkill with the same cameras."""
    ratio: float
    """Median over rounds of stock / ours within one round."""
    steps_per_s: float
    """Control steps per second of the physics phase, without resets."""
    physics_per_min: float
    """Demonstrations per minute by physics alone, resets included."""
    recorded_per_min: float
    """Demonstrations per minute with physics, pictures and files; 0 when none was asked for."""

    @property
    def target(self) -> float:
        """Ratio to reach; 0 for sizes without one."""
        return TARGETS.get((self.case.width, self.case.height), 0.0)

    @property
    def reached(self) -> bool:
        """Whether the ratio is what it should be."""
        return self.ratio >= self.target


def stock_env(task: Task, width: int, height: int) -> Any:
    """ManiSkill's PickCube as it comes, with this task's cameras in place of its own."""
    import sapien
    from mani_skill.envs.tasks.tabletop.pick_cube import PickCubeEnv
    from mani_skill.sensors.camera import CameraConfig as ManiSkillCamera

    from codediffuser.datagen.cameras import T_world_camera, sapien_camera_pose
    from codediffuser.datagen.robot import base_pose

    cameras = task.config.cameras
    # PickCube's robot stands there; cameras keep their place relative to the robot.
    move = sapien.Pose([-0.615, 0.0, 0.0]) * base_pose(task.config.robot).inv()

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
    tasks: tuple[str, ...] = (),
    *,
    sizes: tuple[tuple[int, int], ...] = tuple(TARGETS),
    rounds: int = 12,
    sets_per_round: int = 5,
    episodes: int = 3,
) -> Iterator[BenchResult]:
    """Measure every task at every size, each in a fresh process; a few minutes on two free cores.

    Args:
        tasks: Registered tasks; none for all.
        sizes: Width and height of the pictures, pixels.
        rounds: How often the two renderers take turns.
        sets_per_round: Sets of pictures in one turn.
        episodes: Demonstrations to simulate, and to record whole; 1 at least.
    """
    for name in tasks:
        if name not in TASKS.names():
            raise NotRegisteredError(unknown_name("task", name, TASKS.names()))
    cases = [
        BenchCase(name, width, height, rounds, sets_per_round, max(episodes, 1))
        for name in tasks or TASKS.names()
        for width, height in sizes
    ]
    outcomes = run_tasks(measure, cases, timeout_s=3600, max_tries=1, recycle_after=1)
    for outcome in outcomes:
        if outcome.value is None:
            raise SetupError(f"{outcome.task}: {outcome.error}")
        yield outcome.value


def measure(case: BenchCase) -> BenchResult:
    """Measure one case in this process."""
    from codediffuser.datagen.rendering import Renderer
    from codediffuser.datagen.views import moment_at

    task = get_task(case.task)
    runs, steps_per_s, physics_per_min = _measure_physics(task, case.episodes)
    trajectory = runs[0].trajectory
    size = {"width": case.width, "height": case.height}
    renderer = Renderer(task, task.config.cameras.model_copy(update=size))
    renderer.set_scene(runs[0].scene)
    stock = stock_env(task, case.width, case.height)
    stock.reset(seed=0)
    action = np.zeros(stock.action_space.shape, dtype=np.float32)
    moments = _endless(trajectory.num_steps)

    def ours() -> None:
        renderer.render(moment_at(trajectory, next(moments)))

    def theirs() -> None:
        stock.step(action)

    pairs = list(_interleaved(ours, theirs, case.rounds, case.sets_per_round))
    stock.close()
    return BenchResult(
        case=case,
        cameras=len(renderer.parameters),
        ours_s=statistics.median(a for a, _ in pairs),
        stock_s=statistics.median(b for _, b in pairs),
        ratio=statistics.median(b / a for a, b in pairs),
        steps_per_s=steps_per_s,
        physics_per_min=physics_per_min,
        recorded_per_min=_measure_recording(case),
    )


def _measure_physics(task: Task, episodes: int) -> tuple[list[Any], float, float]:
    """Demonstrations, control steps/s without resets, demonstrations/min with them (medians)."""
    from codediffuser.datagen.envs import physics_env
    from codediffuser.datagen.scene_sampler import sample_scene
    from codediffuser.datagen.script import run_expert

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


def _measure_recording(case: BenchCase) -> float:
    """Demonstrations per minute from scene file to episode folder, start of the process aside."""
    from codediffuser.datagen.pictures import PictureOptions
    from codediffuser.datagen.record import DemoJob, record_demo
    from codediffuser.datagen.scene import scene_path
    from codediffuser.datagen.scene_sampler import sample_scene

    options = PictureOptions(width=case.width, height=case.height)
    seconds = []
    with tempfile.TemporaryDirectory(prefix="codediffuser-bench-") as folder:
        run = Path(folder)
        for index in range(case.episodes):
            scene = sample_scene(get_task(case.task), root_seed=0, index=index)
            scene.save(scene_path(run, scene.scene_id))
            began = time.perf_counter()
            record_demo(DemoJob(run, scene.scene_id, options))
            seconds.append(time.perf_counter() - began)
    return 60 / statistics.median(seconds)


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


HEADINGS = (
    "task", "pictures", "ours sets/s", "stock sets/s", "ratio", "target",
    "physics steps/s", "physics demos/min", "recorded demos/min",
)  # fmt: skip


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows under the headings, in columns."""
    widths = [max(len(row[i]) for row in (HEADINGS, *rows)) for i in range(len(HEADINGS))]
    lines = (HEADINGS, *rows)
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def row(result: BenchResult) -> tuple[str, ...]:
    """One result as cells."""
    case, verdict = result.case, "reached" if result.reached else "MISSED"
    return (
        case.task,
        f"{result.cameras} x {case.width}x{case.height}",
        f"{1 / result.ours_s:.1f}",
        f"{1 / result.stock_s:.1f}",
        f"{result.ratio:.1f}",
        f"{result.target:g} {verdict}" if result.target else "",
        f"{result.steps_per_s:.0f}",
        f"{result.physics_per_min:.0f}",
        f"{result.recorded_per_min:.1f}",
    )


def main() -> int:
    """Print the table; 3 when a ratio is below its target."""
    results = list(tyro.cli(run_bench))
    sys.stdout.write(table([row(r) for r in results]) + "\n")
    return 0 if all(r.reached for r in results) else BelowTargetError.exit_code


if __name__ == "__main__":
    raise SystemExit(main())
