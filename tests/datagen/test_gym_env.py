"""The gymnasium face: passes gymnasium's own checker, and keeps LeRobot's contract."""

from __future__ import annotations

import copy
import warnings
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import TASKS, get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import ConfigError, ShapeError

gym_env = pytest.importorskip("codediffuser.datagen.gym_env")

if TYPE_CHECKING:
    from codediffuser.datagen.script import ExpertRun

ID = "codediffuser/PackBattery-v1"


@pytest.fixture(scope="module")
def env() -> Any:
    return gym.make(ID).unwrapped


@pytest.fixture
def small(pack_battery: PackBattery) -> dict[str, Any]:
    cameras = pack_battery.config.cameras.model_copy(update={"width": 64, "height": 48})
    return {"cameras": cameras, "num_points": 128, "max_steps": 3}


@pytest.mark.sim
@pytest.mark.parametrize(
    ("task", "obs"),
    [(task, "state") for task in TASKS.names()]
    + [("pack_battery", "points"), ("pack_battery", "images")],
)
def test_gymnasium_checker_finds_nothing_wrong(task: str, obs: str) -> None:
    cameras = get_task(task).config.cameras.model_copy(update={"width": 64, "height": 48})
    small: dict[str, Any] = {"cameras": cameras, "num_points": 128, "max_steps": 3}
    env = gym.make(gym_env.gym_id(task), obs=obs, render_mode="rgb_array", **small).unwrapped
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*WARN.*")
        # Metres and unbounded positions are meant: it would like [-1, 1].
        warnings.filterwarnings("ignore", message=".*(symmetric and normalized|infinity).*")
        check_env(env)


def test_every_task_is_registered() -> None:
    for name in TASKS.names():
        assert gym_env.gym_id(name) in gym.registry


def test_lerobot_finds_what_it_asks_of_an_environment(env: Any) -> None:
    _, info = env.reset(seed=0)
    assert env.metadata["render_fps"] == 25
    assert env._max_episode_steps == 240
    assert env.task == "pack_battery"
    assert env.task_description == env.sim.scene_spec.instruction.text != ""
    assert info["is_success"] is False


def test_vector_environment_carries_text_and_final_info(small: dict[str, Any]) -> None:
    made = gym.vector.SyncVectorEnv(
        [lambda: gym.make(ID, **small)] * 2, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP
    )
    obs, _ = made.reset(seed=[1, 2])
    assert obs["agent_pos"].shape == (2, 10)
    assert list(obs["instruction"]) == list(made.call("task_description"))
    actions = obs["agent_pos"].copy()
    for _ in range(3):
        obs, _, _, truncated, info = made.step(actions)
    assert truncated.all()
    assert info["final_info"]["is_success"].tolist() == [False, False]
    made.close()


def test_given_scene_is_what_is_reset_to(env: Any, scenes: list[SceneSpec]) -> None:
    obs, _ = env.reset(seed=0, options={"scene": scenes[7]})
    assert env.sim.scene_spec == scenes[7]
    assert obs["instruction"] == scenes[7].instruction.text


def test_demonstration_played_through_it_succeeds_and_runs_on(
    env: Any, expert_run: ExpertRun
) -> None:
    env.reset(options={"scene": expert_run.scene})
    for action in expert_run.trajectory.actions:
        _, reward, terminated, truncated, info = env.step(action)
        assert not terminated and not truncated
    assert info["is_success"] and reward == 1.0 and info["failed_conditions"] == ""
    assert info["conditions"]["upright"] > 0.99


def test_demonstration_ends_at_success_when_asked(expert_run: ExpertRun) -> None:
    env = gym.make(ID, terminate_on_success=True).unwrapped
    env.reset(options={"scene": expert_run.scene})
    ended = next(i for i, action in enumerate(expert_run.trajectory.actions) if env.step(action)[2])
    release = expert_run.phases.index("release")
    assert release < ended < 185
    env.close()


def test_observing_does_not_change_physics(env: Any, expert_run: ExpertRun, physics: Any) -> None:
    env.reset(options={"scene": expert_run.scene})
    for action in expert_run.trajectory.actions[:20]:
        obs, *_ = env.step(action)
    expected = expert_run.trajectory
    np.testing.assert_array_equal(env.sim.view.moment().qpos, expected.qpos[20])
    np.testing.assert_allclose(obs["agent_pos"][:3], expected.hand_position_m[20], atol=1e-6)


@pytest.mark.parametrize("bad", [np.zeros(9), np.full(10, np.nan)])
def test_bad_action_is_refused_and_nothing_moves(env: Any, bad: np.ndarray) -> None:
    env.reset(seed=0)
    before = copy.deepcopy(env.sim.view.moment().qpos)
    with pytest.raises(ShapeError, match="expected an action of 10 finite numbers"):
        env.step(bad)
    np.testing.assert_array_equal(env.sim.view.moment().qpos, before)


def test_unknown_observation_is_refused() -> None:
    with pytest.raises(ConfigError, match="obs: expected 'state', 'points' or 'images'"):
        gym_env.TaskEnv("pack_battery", obs="pointcloud")


def test_step_before_reset_says_so() -> None:
    with pytest.raises(ConfigError, match="call reset"):
        gym_env.TaskEnv("pack_battery").step(np.zeros(10))


@pytest.mark.sim
def test_points_lie_in_the_workspace(small: dict[str, Any], pack_battery: PackBattery) -> None:
    env = gym.make(ID, obs="points", **small).unwrapped
    points = env.reset(seed=0)[0]["robot_state"]["points"]
    box = pack_battery.config.workspace
    assert points.shape == (128, 3)
    assert (points >= box.low_m).all() and (points <= box.high_m).all()
    env.close()
