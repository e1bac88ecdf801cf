"""Every task runs under ManiSkill's own wrappers, as its users expect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import h5py
import numpy as np
import pytest

from codediffuser.datagen.task import TASKS

envs = pytest.importorskip("codediffuser.datagen.envs")


def wrapped(task: str, folder: Path, **options: Any) -> Any:
    from mani_skill.utils.wrappers import CPUGymWrapper, RecordEpisode

    env = gym.make(envs.env_id(task), obs_mode="state", render_backend="none", max_episode_steps=4)
    env = RecordEpisode(env, str(folder), trajectory_name="trajectory", save_video=False, **options)
    return CPUGymWrapper(env)


def hold_still(env: Any) -> np.ndarray:
    """The action that keeps the hand where it is."""
    from codediffuser.datagen.views import state_row

    return state_row(env.unwrapped.view.moment())


@pytest.mark.parametrize("task", TASKS.names())
def test_episodes_are_recorded_with_states_and_seeds(task: str, tmp_path: Path) -> None:
    env = wrapped(task, tmp_path)
    scenes = []
    for seed in (3, 4):
        obs, _ = env.reset(seed=seed)
        scenes.append(env.unwrapped.scene_spec)
        assert obs.ndim == 1 and obs.dtype == np.float32
        truncated, steps = False, 0
        while not truncated:
            obs, reward, terminated, truncated, info = env.step(hold_still(env))
            assert np.ndim(reward) == 0 and not terminated
            assert not info["success"]
            steps += 1
        assert steps == 4
    env.close()
    described = json.loads((tmp_path / "trajectory.json").read_text())
    assert [e["episode_seed"] for e in described["episodes"]] == [3, 4]
    with h5py.File(tmp_path / "trajectory.h5") as stored:
        for number, scene in enumerate(scenes):
            episode = stored[f"traj_{number}"]
            assert episode["actions"].shape == (4, 10)
            movable = {o.id for o in scene.objects if not o.fixed}
            assert movable <= set(episode["env_states/actors"])
            assert episode[f"env_states/actors/{min(movable)}"].shape[0] == 5


@pytest.mark.parametrize("task", TASKS.names())
def test_vector_environments_of_gymnasium_take_them(task: str) -> None:
    from mani_skill.utils.wrappers import CPUGymWrapper

    def make() -> Any:
        return CPUGymWrapper(
            gym.make(envs.env_id(task), obs_mode="state_dict", render_backend="none")
        )

    env = gym.vector.SyncVectorEnv([make])
    obs, _ = env.reset(seed=1)
    action = hold_still(env.envs[0])
    obs, reward, _, _, _ = env.step(action[None])
    assert obs["extra"]["hand_pose"].shape == (1, 7)
    assert reward.shape == (1,)
    env.close()
