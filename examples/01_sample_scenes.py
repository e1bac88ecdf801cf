"""Draw one scene of every task and variant: what is asked for, and every way to do it.

Needs no simulator. The same seed and number always give the same scene, whatever was drawn before.

    python examples/01_sample_scenes.py --out runs/scenes
"""

from __future__ import annotations

from pathlib import Path

import tyro

import codediffuser.datagen.tasks  # noqa: F401  fills TASKS
from codediffuser.datagen.reset_image import save_pictures
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene_sampler import SceneSource
from codediffuser.datagen.task import TASKS, get_task


def main(out: Path, seed: int = 0, index: int = 3) -> None:
    """Print sentences and pairs; write the picture by which an operator resets each scene."""
    out.mkdir(parents=True, exist_ok=True)
    for name in TASKS.names():
        task = get_task(name)
        for variant in ("sim", "real"):
            source = SceneSource(task, SamplingSettings(root_seed=seed, variant=variant))
            scene = source.draw(index)
            picture = out / f"{name}_{variant}.png"
            save_pictures(task.draw_reset(scene), picture)
            print(f"{name}, {variant}: {scene.instruction.text}")
            print(f"  {scene.ambiguity.picks} objects, {scene.ambiguity.places} places; allowed:")
            for pick, place in scene.instruction.pairs:
                print(f"    {pick} -> {place}")
            print(f"  picture: {picture}")


if __name__ == "__main__":
    tyro.cli(main)
