from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytestmark = [pytest.mark.sim, pytest.mark.slow]


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    import gymnasium as gym

    import codediffuser.training.attention_env as module

    made = gym.make(module.attended_id("pack_battery"), width=80, height=60)
    yield made
    made.close()


def test_observations_fit_their_space_and_attend_to_the_target(env: Any) -> None:
    seen, _ = env.reset(seed=3)
    assert env.observation_space.contains(seen)
    scene, points = env.unwrapped.sim.scene_spec, seen["robot_state"]["points"]
    pick = points[points[:, 3] > 0.5, :3].mean(axis=0)
    place = points[points[:, 4] > 0.5, :3].mean(axis=0)
    target = scene.object(scene.target.pick).position_m[:2]
    slot = scene.place(scene.target.place).position_m[:2]
    assert np.linalg.norm(pick[:2] - target) < 0.02
    assert np.linalg.norm(place[:2] - slot) < 0.02


def test_the_same_seed_gives_the_same_observation(env: Any) -> None:
    one, _ = env.reset(seed=5)
    two, _ = env.reset(seed=5)
    assert np.array_equal(one["robot_state"]["points"], two["robot_state"]["points"])


def test_lerobot_finds_what_it_asks_of_an_environment(env: Any) -> None:
    env.reset(seed=3)
    assert env.get_wrapper_attr("_max_episode_steps") == 240
    assert env.task == "pack_battery" and env.task_description
    assert env.unwrapped.metadata["render_fps"] == 25
    seen, reward, terminated, truncated, info = env.step(env.reset(seed=3)[0]["agent_pos"])
    assert info["is_success"] is False and reward == 0.0 and not terminated and not truncated
    assert env.observation_space.contains(seen)
