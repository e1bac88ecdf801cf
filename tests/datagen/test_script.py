"""The script runner: smooth commands, honest failures, a reliable expert."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from codediffuser.datagen.motion import Command, end_command, interpolate, slerp
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.script import run_expert
from codediffuser.datagen.task import Move, SceneView
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.poses import (
    make_transform,
    matrix_to_quat_wxyz,
    quat_wxyz_to_matrix,
    rot6d_to_matrix,
    rotation_z,
)

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.script import ExpertRun

START = Command(np.zeros(3), np.array([1.0, 0, 0, 0]), 0.04)


def move(x: float = 0.1, yaw: float = 1.0, steps: int = 20, gripper: float = 0.0) -> Move:
    return Move("test", make_transform(rotation_z(yaw), np.array([x, 0, 0])), steps, gripper)


def test_move_ends_exactly_at_its_pose() -> None:
    last = interpolate(START, move())[-1]
    np.testing.assert_allclose(last[:3], [0.1, 0, 0], atol=1e-7)
    np.testing.assert_allclose(rot6d_to_matrix(last[3:9]), rotation_z(1.0), atol=1e-6)
    assert last[9] == 0.0


def test_position_starts_and_ends_slowly_while_the_gripper_moves_evenly() -> None:
    actions = interpolate(START, move(steps=20))
    speed = np.diff(actions[:, 0], prepend=0.0)
    assert speed[0] < 0.3 * speed[10] and speed[-1] < 0.3 * speed[10]
    np.testing.assert_allclose(np.diff(actions[:, 9]), -0.002, atol=1e-7)


def test_move_of_one_step_is_its_end() -> None:
    assert interpolate(START, move(steps=1)).shape == (1, 10)


def test_next_move_starts_where_the_last_was_commanded() -> None:
    first, second = move(x=0.1), move(x=0.3, yaw=-0.5)
    joint = interpolate(end_command(first), second)
    step = np.linalg.norm(joint[0, :3] - interpolate(START, first)[-1, :3])
    assert step < 0.2 * 0.02


def test_slerp_turns_evenly_and_takes_the_short_way() -> None:
    a = matrix_to_quat_wxyz(rotation_z(0.2))
    b = -matrix_to_quat_wxyz(rotation_z(1.2))
    turned = quat_wxyz_to_matrix(slerp(a, b, np.array([0.0, 0.25, 1.0])))
    for R, yaw in zip(turned, (0.2, 0.45, 1.2), strict=True):
        np.testing.assert_allclose(R, rotation_z(yaw), atol=1e-9)


def test_slerp_between_equal_rotations_stays() -> None:
    a = matrix_to_quat_wxyz(rotation_z(0.7))
    np.testing.assert_allclose(slerp(a, a, np.array([0.3])), a[None], atol=1e-12)


def test_expert_run_is_whole(expert_run: ExpertRun) -> None:
    assert expert_run.success and expert_run.failure_phase == ""
    trajectory = expert_run.trajectory
    assert trajectory.num_steps == len(expert_run.phases) == 185
    assert len(trajectory.qpos) == 186
    order = list(dict.fromkeys(expert_run.phases))
    assert order == [
        "approach", "descend", "grasp", "lift", "transport", "lower", "release", "retreat", "home",
    ]  # fmt: skip


def test_nothing_is_teleported(expert_run: ExpertRun) -> None:
    trajectory = expert_run.trajectory
    object_steps = np.linalg.norm(np.diff(trajectory.object_position_m, axis=0), axis=-1)
    assert object_steps.max() < 0.06  # 1.5 m/s
    assert np.abs(np.diff(trajectory.qpos[:, :7], axis=0)).max() < 0.15


def test_same_scene_and_generator_give_the_same_bits(
    physics: SceneEnv, expert_run: ExpertRun
) -> None:
    again = run_expert(physics, expert_run.scene, np.random.default_rng(0)).trajectory
    for name in ("object_position_m", "object_velocity", "qpos", "actions"):
        np.testing.assert_array_equal(getattr(again, name), getattr(expert_run.trajectory, name))


def test_unreachable_pose_is_a_recorded_failure(
    physics: SceneEnv, scenes: list[SceneSpec], monkeypatch: pytest.MonkeyPatch
) -> None:
    def script(self: PackBattery, view: SceneView, rng: np.random.Generator) -> Iterator[Move]:
        down = view.T_world_hand()
        yield Move("approach", down, 3, 0.04)
        far = down.copy()
        far[:3, 3] = (0.0, 1.8, 0.3)
        yield Move("reach", far, 40, 0.04)
        raise AssertionError("the run must end before")

    monkeypatch.setattr(PackBattery, "script", script)
    run = run_expert(physics, scenes[0], np.random.default_rng(0))
    assert not run.success
    assert run.failure_phase == "reach:unreachable"
    assert "pack_battery scene 000000, phase 'reach', step" in run.failure_reason
    assert 3 < run.trajectory.num_steps < 43
    assert len(run.trajectory.qpos) == run.trajectory.num_steps + 1


def test_missed_grasp_is_a_failure_with_its_phase(
    physics: SceneEnv, scenes: list[SceneSpec], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        PackBattery,
        "script",
        lambda self, view, rng: iter([Move("wait", view.T_world_hand(), 5, 0.0)]),
    )
    run = run_expert(physics, scenes[0], np.random.default_rng(0))
    assert run.failure_phase == "grasp:missed"
    assert "xy_distance_m" in run.failure_reason


@pytest.mark.slow
def test_expert_succeeds_in_nearly_all_scenes(physics: SceneEnv, scenes: list[SceneSpec]) -> None:
    runs = [
        run_expert(physics, scene, np.random.default_rng(i))
        for i, scene in enumerate(scenes[100:140])
    ]
    failed = {r.scene.scene_id: (r.failure_phase, r.failure_reason) for r in runs if not r.success}
    assert len(failed) <= 1, failed
