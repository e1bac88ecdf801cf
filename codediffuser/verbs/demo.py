"""`codediffuser demo`: scripted demonstrations of a run's scenes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from codediffuser.errors import BelowTargetError
from codediffuser.verbs.verb import Verb, console, track


@dataclass(kw_only=True)
class Demo(Verb):
    """Demonstrate every scene of RUN/scenes in the simulator, into RUN/episodes.

    Physics first, pictures second, from the stored states. Running again continues; a scene that
    the expert failed is counted with its reason and not tried again unless --overwrite.

    Example: codediffuser demo runs/pack --workers 2 --size 160x120
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with scenes/."""
    workers: int = 1
    """Processes. Changes nothing but the time."""
    size: Literal["160x120", "320x240", "480x360", "640x480", "task"] = "task"
    """Width and height of the pictures; `task` takes those of the task's YAML."""
    image_format: Literal["jpeg", "png"] = "jpeg"
    """Compression of the colour pictures. Depth is always lossless."""
    rerender: bool = False
    """Only make the pictures again, from the stored states of episodes that are there."""
    overwrite: bool = False
    """Make whole episodes again and try failures again."""
    min_success: float = 0.0
    """Exit with code 3 when fewer than this share of the scenes became episodes."""

    def run(self) -> Path:
        """Collect and return the folder of episodes."""
        from codediffuser.datagen.collect import collect_demos, rerender, scene_ids
        from codediffuser.datagen.demo_results import SUMMARY, DemoSummary
        from codediffuser.datagen.episode_format import EPISODES, ImageOptions
        from codediffuser.datagen.record import PictureOptions

        width, height = (None, None) if self.size == "task" else map(int, self.size.split("x"))
        options = PictureOptions(
            width=width, height=height, image=ImageOptions(format=self.image_format)
        )
        work = rerender if self.rerender else collect_demos
        total = len(scene_ids(self.run_folder))
        results = work(
            self.run_folder, workers=self.workers, overwrite=self.overwrite, options=options
        )
        for _ in track(results, "rerender" if self.rerender else "demo", total):
            pass
        if self.rerender:
            return self.run_folder / EPISODES
        summary = DemoSummary.load(self.run_folder / SUMMARY)
        console.print(
            f"{summary.episodes} of {summary.scenes} scenes demonstrated; "
            f"{summary.bytes_per_episode / 1e6:.1f} MB an episode; "
            f"{summary.control_steps_per_s:.0f} control steps/s and "
            f"{summary.camera_sets_per_s:.1f} camera sets/s per process"
        )
        for phase, count in summary.failures_by_phase.items():
            console.print(f"  failed {count} x {phase}")
        if summary.success_rate < self.min_success:
            raise BelowTargetError(
                f"{summary.episodes} of {summary.scenes} scenes succeeded, below the "
                f"--min-success of {self.min_success}; see {self.run_folder / SUMMARY}"
            )
        return self.run_folder / EPISODES
