"""`codediffuser train`: the attention-conditioned diffusion policy, by our own short loop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.progress import BarColumn, Progress, TextColumn

from codediffuser.errors import ConfigError
from codediffuser.verbs.verb import Verb, console


@dataclass(kw_only=True)
class Train(Verb):
    """Train a policy on RUN/lerobot, into RUN/checkpoints/NAME.

    Running again continues from the newest checkpoint. Checkpoints are LeRobot's: stock
    `lerobot-eval --policy.path=...` loads them.

    Example: codediffuser train runs/pack --preset cpu
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with lerobot/, or the folder of a LeRobot dataset itself."""
    preset: str = "cpu"
    """`cpu` (small, tested here), `paper` (the supplement's sizes, for a GPU), or a YAML file."""
    name: str | None = None
    """Folder under RUN/checkpoints. Default: the preset's name."""
    steps: int | None = None
    """Optimiser steps; the learning rate ends there. Default: the preset's."""
    seed: int | None = None
    """Of weights, batches and noise."""
    attention: Literal["separate", "merged", "none"] | None = None
    """How the policy sees attention; `none` zeroes it, an ablation. Default: the preset's."""
    max_minutes: float | None = None
    """Stop and save after this time, wherever the schedule is."""
    num_threads: int | None = None
    """Threads of one torch operation. Default: the preset's. More than one pays for large networks
    on idle cores only: threads that wait for each other spin, and beside other work they crawl."""
    overwrite: bool = False
    """Forget the checkpoints of this name and begin anew."""

    def run(self) -> Path:
        """Train and return the folder of the checkpoints."""
        from codediffuser.training.config import load_preset
        from codediffuser.training.loop import train

        if self.steps is not None and self.steps < 1:
            raise ConfigError(f"--steps: expected at least 1, got {self.steps}")
        config = load_preset(self.preset)
        config = config.with_changes(**self._changes())
        root = self.run_folder
        if not (root / "lerobot").is_dir() and (root / "meta" / "info.json").is_file():
            root = root.parent
        out = root / "checkpoints" / config.name
        with Progress(
            TextColumn("[bold]train"), BarColumn(bar_width=32), TextColumn("{task.fields[note]}"),
            console=console,
        ) as progress:  # fmt: skip
            bar = progress.add_task("train", total=None, note="loading the cache")
            for now in train(self.run_folder, config, out, overwrite=self.overwrite):
                error = "" if now.val_error_mm is None else f"  val {now.val_error_mm:.1f} mm"
                loss = "" if math.isnan(now.loss) else f"loss {now.loss:.4f}  "
                progress.update(
                    bar, completed=now.step, total=now.total_steps,
                    note=f"{now.step}/{now.total_steps}  {loss}{now.steps_per_s:.1f} steps/s  "
                    f"{now.eta_s / 60:.1f} min left{error}",
                )  # fmt: skip
        return out

    def _changes(self) -> dict[str, Any]:
        asked = {
            "name": self.name,
            "steps": self.steps,
            "seed": self.seed,
            "max_minutes": self.max_minutes,
            "num_threads": self.num_threads,
        }
        changes: dict[str, Any] = {k: v for k, v in asked.items() if v is not None}
        if self.attention is not None:
            changes["policy"] = {"attention_channels": self.attention}
        return changes
