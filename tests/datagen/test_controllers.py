"""Hand-pose control: reaches what it is told, holds when it cannot, and says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from codediffuser.datagen.controllers import action_space
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.trajectory import ACTION_NAMES
from codediffuser.datagen.views import state_row
from codediffuser.poses import matrix_to_rot6d, rotation_z

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv

R_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def action(x: float, y: float, z: float, yaw: float = 0.0, gripper: float = 0.04) -> np.ndarray:
    rot6d = matrix_to_rot6d(rotation_z(yaw) @ R_DOWN)
    return np.array([x, y, z, *rot6d, gripper], dtype=np.float32)


@pytest.fixture
def env(physics: SceneEnv, scenes: list[SceneSpec]) -> SceneEnv:
    physics.reset(options={"scene": scenes[0]})
    return physics


def test_action_space_has_one_bound_per_action_name() -> None:
    assert action_space().shape == (len(ACTION_NAMES),)


@pytest.mark.parametrize("target", [(0.1, 0.0, 0.3), (-0.1, 0.1, 0.35), (0.0, 0.15, 0.28)])
def test_hand_settles_at_the_commanded_pose(
    env: SceneEnv, target: tuple[float, float, float]
) -> None:
    command = action(*target, yaw=0.4, gripper=0.02)
    for _ in range(60):
        env.control_step(command)
    assert env.ik_failures == 0
    np.testing.assert_allclose(state_row(env.view.moment()), command, atol=2e-3)


def test_out_of_reach_keeps_the_arm_and_is_counted(env: SceneEnv) -> None:
    env.control_step(action(0.0, 0.05, 0.3))
    before = env.agent.controller.get_state()["target_qpos"].clone()
    env.control_step(action(0.0, 3.0, 0.3))
    after = env.agent.controller.get_state()["target_qpos"]
    assert env.ik_failures == 1
    np.testing.assert_array_equal(before[0, :7], after[0, :7])


def test_parallel_rotation_columns_count_as_unreachable(env: SceneEnv) -> None:
    broken = action(0.0, 0.0, 0.3)
    broken[6:9] = broken[3:6]
    env.control_step(broken)
    assert env.ik_failures == 1


def test_gripper_follows_although_the_arm_cannot(env: SceneEnv) -> None:
    for _ in range(20):
        env.control_step(action(0.0, 3.0, 0.3, gripper=0.01))
    assert env.view.gripper_opening_m() == pytest.approx(0.01, abs=1e-3)


def test_gripper_command_is_clipped_to_its_range(env: SceneEnv) -> None:
    for opening, expected in ((0.5, 0.04), (-0.5, 0.0)):
        env.control_step(action(0.0, 0.0, 0.3, gripper=opening))
        targets = env.agent.controller.get_state()["target_qpos"][0, 7:]
        np.testing.assert_allclose(targets, expected, atol=1e-7)


def test_reset_forgets_failures(env: SceneEnv, scenes: list[SceneSpec]) -> None:
    env.control_step(action(0.0, 3.0, 0.3))
    env.reset(options={"scene": scenes[0]})
    assert env.ik_failures == 0


def test_restored_controller_goes_on_exactly(env: SceneEnv) -> None:
    env.control_step(action(0.03, 0.02, 0.31))
    state = env.agent.controller.get_state()
    env.agent.controller.command(action(0.05, 0.02, 0.31))
    expected = env.agent.controller.get_state()["target_qpos"]
    env.agent.controller.set_state(state)
    env.agent.controller.command(action(0.05, 0.02, 0.31))
    np.testing.assert_array_equal(env.agent.controller.get_state()["target_qpos"], expected)
