"""The ManiSkill environment: registered, reproducible to the bit, honest about its limits."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import TASKS
from codediffuser.errors import ConfigError

envs = pytest.importorskip("codediffuser.datagen.envs")

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.script import ExpertRun


def play(env: Any, scene: SceneSpec, actions: np.ndarray) -> np.ndarray:
    """Every number of every state, in one array."""
    env.reset(options={"scene": scene})
    rows = [state(env)]
    for action in actions:
        env.control_step(action)
        rows.append(state(env))
    return np.array(rows)


def state(env: Any) -> np.ndarray:
    m = env.view.moment()
    parts = (m.object_position_m, m.object_quat_wxyz, m.object_velocity, m.qpos, m.qvel)
    return np.concatenate([np.ravel(p) for p in parts])


def test_every_task_is_registered_under_its_camel_case_name() -> None:
    assert envs.env_id("pack_battery") == "PackBattery-v1"
    for name in TASKS.names():
        assert envs.env_id(name) in gym.registry


def test_an_episode_does_not_depend_on_the_episodes_before(
    physics: SceneEnv, scenes: list[SceneSpec], expert_run: ExpertRun
) -> None:
    actions = expert_run.trajectory.actions[:120]  # up to a battery in the air, over the crate
    first = play(physics, scenes[0], actions)
    for other in scenes[1:4]:
        play(physics, other, actions[:30])
    again = play(physics, scenes[0], actions)
    fresh = play(envs.physics_env("pack_battery", scenes[5]), scenes[0], actions)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, fresh)


def test_lean_step_and_maniskill_step_give_identical_states(
    physics: SceneEnv, expert_run: ExpertRun
) -> None:
    actions = expert_run.trajectory.actions[:60]
    lean = play(physics, expert_run.scene, actions)
    physics.reset(options={"scene": expert_run.scene})
    for i, action in enumerate(actions):
        physics.step(action)
        np.testing.assert_array_equal(state(physics), lean[i + 1])
    assert int(physics.elapsed_steps[0]) == len(actions)


def test_evaluate_reports_every_condition_with_value_and_verdict(
    physics: SceneEnv, scenes: list[SceneSpec]
) -> None:
    physics.reset(options={"scene": scenes[0]})
    info = physics.evaluate()
    assert info["success"].dtype == torch.bool and info["success"].shape == (1,)
    assert not bool(info["success"])
    for condition in physics.check().conditions:
        assert float(info[condition.name]) == pytest.approx(condition.value, rel=1e-5)
        assert bool(info[f"{condition.name}_ok"]) == condition.holds


def test_success_rewards_the_last_state_of_a_demonstration(
    physics: SceneEnv, expert_run: ExpertRun
) -> None:
    play(physics, expert_run.scene, expert_run.trajectory.actions)
    _, reward, terminated, _, info = physics.step(expert_run.trajectory.actions[-1])
    assert bool(info["success"]) and bool(terminated) and float(reward) == 1.0


def test_same_seed_draws_the_same_scene_and_another_seed_another(physics: SceneEnv) -> None:
    drawn = []
    for seed in (3, 4, 3):
        physics.reset(seed=seed)
        drawn.append(physics.scene_spec)
    assert drawn[0] == drawn[2] != drawn[1]


def test_resets_without_a_seed_go_on_to_new_scenes(physics: SceneEnv) -> None:
    physics.reset(seed=3)
    first = physics.scene_spec
    physics.reset()
    assert physics.scene_spec != first


@pytest.mark.parametrize("wanted", [{"num_envs": 4}, {"sim_backend": "physx_cuda"}])
def test_gpu_simulation_is_refused_with_a_way_out(wanted: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"expected sim_backend 'physx_cpu'.*several processes"):
        envs.SceneEnv(task="pack_battery", **wanted)


def test_scene_of_another_task_is_refused(physics: SceneEnv, scenes: list[SceneSpec]) -> None:
    other = scenes[0].model_copy(update={"task": "stow_book"})
    with pytest.raises(ConfigError, match="scene 000000 is of task 'stow_book'"):
        physics.reset(options={"scene": other})


def test_physics_needs_no_vulkan_and_pictures_say_what_is_missing() -> None:
    code = """
from codediffuser.datagen.envs import physics_env
print("objects", len(physics_env("pack_battery").view.object_ids))
from codediffuser.datagen.rendering import Renderer
from codediffuser.datagen.task import get_task
from codediffuser.errors import SetupError
try:
    Renderer(get_task("pack_battery"))
except SetupError as error:
    print("refused:", error)
"""
    nowhere = {"VK_ICD_FILENAMES": "/nonexistent.json", "VK_DRIVER_FILES": "/nonexistent.json"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **nowhere, "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, timeout=240, check=True,
    )  # fmt: skip
    assert "objects" in done.stdout
    assert "refused: SAPIEN finds no Vulkan device" in done.stdout
    assert "codediffuser doctor" in done.stdout


@pytest.mark.sim
def test_maniskill_observations_hold_every_camera(scenes: list[SceneSpec]) -> None:
    env = gym.make(
        "PackBattery-v1", scene=scenes[0], obs_mode="rgb+depth", render_backend="cpu",
        sensor_configs={"width": 64, "height": 48},
    )  # fmt: skip
    obs, _ = env.reset()
    assert set(obs["sensor_data"]) == {v.name for v in env.unwrapped.task.config.cameras.views}
    for pictures in obs["sensor_data"].values():
        assert pictures["rgb"].shape == (1, 48, 64, 3)
        assert pictures["rgb"].float().std() > 5
    env.close()
