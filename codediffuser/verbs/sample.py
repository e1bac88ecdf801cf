"""`codediffuser sample`: scene files, each with the picture an operator resets by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from codediffuser.errors import ConfigError
from codediffuser.verbs.verb import NumEpisodes, Verb, track


@dataclass(kw_only=True)
class Sample(Verb):
    """Draw initial configurations: a YAML and a reset picture each.

    Example: codediffuser sample pack_battery -n 180 --seed 0 --out runs/pack/scenes
    """

    task: tyro.conf.Positional[str]
    """Name of a task: pack_battery."""
    out: Path
    """Folder for the scenes; `demo RUN` looks for them in RUN/scenes."""
    num_episodes: NumEpisodes = 10
    """How many configurations. More of the same seed continue the set."""
    seed: int = 0
    """Root seed. The same seed gives the same bytes, whatever the number of workers."""
    variant: str = "sim"
    """Which ranges of the task's YAML to draw from."""
    picks: int | None = None
    """Exactly this many objects to choose from; drawn when left out."""
    places: int | None = None
    """Exactly this many free places; drawn when left out."""
    split: Literal["all", "train", "val", "held_out"] = "all"
    """Part of the configuration space, by the key `splits` of the task's YAML."""
    templates: Path | None = None
    """Your own sentences (docs/instructions.md); those that ship when left out."""
    template_split: Literal["all", "seen", "unseen"] = "all"
    """Which sentences: unseen ones are marked in the file, to be kept out of training."""
    stratify: tuple[str, ...] = ()
    """Spread these evenly: kind, template, picks, places, target_place, alone or together."""
    pictures: bool = True
    """Draw the pictures to reset by."""
    workers: int = 1
    """Processes."""
    overwrite: bool = False
    """Draw scenes anew that are already there."""

    def run(self) -> Path:
        """Sample and return the folder."""
        from codediffuser.datagen.instructions.templates import load_templates
        from codediffuser.datagen.sampling_settings import SamplingSettings, parse_factors
        from codediffuser.datagen.scene_files import sample_scenes
        from codediffuser.datagen.scene_sampler import SceneSource
        from codediffuser.datagen.task import get_task

        if self.num_episodes < 1 or self.seed < 0:
            raise ConfigError(
                "expected --num-episodes of at least 1 and --seed of at least 0, "
                f"got {self.num_episodes} and {self.seed}"
            )
        task = get_task(self.task)
        library = load_templates(task.name, self.templates) if self.templates else None
        settings = SamplingSettings(
            root_seed=self.seed, variant=self.variant, split=self.split,
            template_split=None if self.template_split == "all" else self.template_split,
            picks=self.picks, places=self.places, stratify=parse_factors(self.stratify),
        )  # fmt: skip
        scenes = sample_scenes(
            SceneSource(task, settings, library), self.out, self.num_episodes,
            pictures=self.pictures, workers=self.workers, overwrite=self.overwrite,
        )  # fmt: skip
        for _ in track(scenes, "sample", self.num_episodes):
            pass
        return self.out
