"""Let a scripted expert solve scenes by physics alone, and see by which conditions it is judged.

Nothing is drawn, so no Vulkan is needed. `codediffuser demo` does the same, in several processes,
and records every camera.

    python examples/02_run_an_expert.py --task hang_mug --scenes 3
"""

from __future__ import annotations

from itertools import groupby

import tyro

from codediffuser.datagen.envs import physics_env
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.script import run_expert
from codediffuser.datagen.task import get_task
from codediffuser.seeding import Stage, rng_for


def main(task: str = "pack_battery", scenes: int = 2, seed: int = 0) -> None:
    """Print the phases of each demonstration and every condition of success."""
    chosen = get_task(task)
    env = physics_env(chosen)
    for index in range(scenes):
        scene = sample_scene(chosen, root_seed=seed, index=index)
        run = run_expert(env, scene, rng_for(seed, Stage.EXPERT, index))
        phases = [f"{phase} {len(list(steps))}" for phase, steps in groupby(run.phases)]
        print(f"{scene.instruction.text}\n  steps: {', '.join(phases)}")
        for condition in run.check.conditions:
            verdict = "holds" if condition.holds else "fails"
            print(f"  {condition.name}: {condition.value:.4f}, {verdict}")
        print(f"  success: {run.success} {run.failure_reason}")
    env.close()


if __name__ == "__main__":
    tyro.cli(main)
