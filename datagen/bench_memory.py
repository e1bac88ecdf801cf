"""Measures whether a recording process keeps its memory: many episodes, no recycling.

Each episode is simulated in full; of its pictures only a few moments are drawn, since what could
leak is what changes from scene to scene: the PhysX scene, meshes, materials, lights.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import tyro

from codediffuser.datagen.demo_results import resident_mb
from codediffuser.datagen.envs import physics_env
from codediffuser.datagen.randomization import draw_appearance, load_randomization
from codediffuser.datagen.rendering import Renderer
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.script import run_expert
from codediffuser.datagen.task import get_task
from codediffuser.datagen.views import moment_at
from codediffuser.errors import BelowTargetError

MAX_GROWTH_MB = 0.2
"""Of memory per episode: 20 MB until the process is replaced, beside 900 MB that it holds."""


@dataclass(frozen=True, slots=True)
class MemoryResult:
    """Memory of the process after each episode."""

    rss_mb: tuple[float, ...]

    @property
    def growth_mb(self) -> float:
        """Slope of a line through the second half, megabytes per episode."""
        half = np.array(self.rss_mb[len(self.rss_mb) // 2 :])
        return float(np.polyfit(np.arange(len(half)), half, 1)[0]) if len(half) > 1 else 0.0


def measure_memory(
    task: str = "pack_battery", *, episodes: int = 300, moments: int = 3, randomize: str = "strong"
) -> Iterator[float]:
    """Demonstrate and draw scenes in this process; yield its memory in MB after each.

    Args:
        task: Registered task.
        episodes: How many scenes.
        moments: How many moments of each are drawn, with all cameras.
        randomize: Preset of domain randomisation, so that all that may leak is exchanged.
    """
    chosen, ranges = get_task(task), load_randomization(randomize)
    env, renderer = physics_env(chosen), Renderer(chosen)
    for index in range(episodes):
        scene = sample_scene(chosen, root_seed=0, index=index)
        trajectory = run_expert(env, scene, np.random.default_rng(index)).trajectory
        looks = draw_appearance(ranges, randomize, chosen, scene, trajectory).looks
        renderer.set_scene(scene, looks)
        for k in np.linspace(0, trajectory.num_steps, moments).astype(int):
            renderer.render(moment_at(trajectory, int(k)))
        yield resident_mb()


def main() -> int:
    """Print memory every tenth of the way and the growth; 3 when it grows too fast."""
    seen = []
    episodes = tyro.cli(measure_memory)
    for number, mb in enumerate(episodes, start=1):
        seen.append(mb)
        if number % 25 == 0 or number == 1:
            sys.stdout.write(f"after {number:4d} episodes {mb:7.1f} MB\n")
            sys.stdout.flush()
    growth = MemoryResult(tuple(seen)).growth_mb
    sys.stdout.write(f"growth over the second half {growth:+.3f} MB an episode\n")
    return 0 if growth <= MAX_GROWTH_MB else BelowTargetError.exit_code


if __name__ == "__main__":
    raise SystemExit(main())
