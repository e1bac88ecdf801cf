"""The gymnasium environment: carry out a recorded demonstration action by action.

Actions are absolute: where the hand shall be (3 m, 6 for the rotation) and how far each finger
opens (1). What the expert commanded solves the same scene again.

    python examples/03_step_the_environment.py --out after.png
"""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import tyro
from PIL import Image

import codediffuser.datagen.gym_env  # noqa: F401  registers the environments
from codediffuser.datagen.envs import physics_env
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.script import run_expert
from codediffuser.datagen.task import get_task
from codediffuser.seeding import Stage, rng_for


def main(out: Path, seed: int = 0) -> None:
    """Replay an expert's actions and save what the first camera sees at the end."""
    task = get_task("pack_battery")
    scene = sample_scene(task, root_seed=seed, index=0)
    demonstration = run_expert(physics_env(task), scene, rng_for(seed, Stage.EXPERT, 0))

    env = gym.make("codediffuser/PackBattery-v1", render_mode="rgb_array")
    obs, info = env.reset(seed=seed, options={"scene": scene})
    print(obs["instruction"])
    for action in demonstration.trajectory.actions:
        obs, _, _, _, info = env.step(action)
    print("success:", info["is_success"], info["conditions"])
    Image.fromarray(np.asarray(env.render())).save(out)
    print("picture:", out)
    env.close()


if __name__ == "__main__":
    tyro.cli(main)
