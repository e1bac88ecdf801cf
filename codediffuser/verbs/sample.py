"""`codediffuser sample`: scene files, each with the picture an operator resets by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from codediffuser.errors import ConfigError
from codediffuser.verbs.verb import NumEpisodes, Verb, console, track


@dataclass(kw_only=True)
class Sample(Verb):
    """Draw initial configurations: a YAML and a reset picture each, pictures of the set, its pads.

    Example: codediffuser sample pack_battery -n 180 --seed 0 --out runs/pack/scenes

    Example: codediffuser sample --check-photo photo.jpg runs/pack/scenes/000007.yaml
    """

    task: tyro.conf.Positional[str | None] = None
    """Name of a task: hang_mug, pack_battery, stow_book."""
    out: Path | None = None
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
    """Spread these evenly: kind, template, picks, places, target_place, start, or combinations."""
    pictures: bool = True
    """Draw the pictures to reset by, those of the set, and the pads to print."""
    paper: Literal["A4", "A3"] = "A4"
    """What pads.pdf is printed on, at 100 %."""
    check_photo: tuple[Path, Path] | None = None
    """PHOTO SCENE.yaml: draw that scene over a photo of its pads, into PHOTO_check.png or --out."""
    overlay_episodes: Path | None = None
    """RUN: blend the first pictures of its episodes into RUN/overlay_CAMERA.png, or into --out."""
    workers: int = 1
    """Processes."""
    overwrite: bool = False
    """Draw scenes anew that are already there."""

    def run(self) -> Path:
        """Do the one thing that was asked for, and return where its result is."""
        asked = [self.task, self.check_photo, self.overlay_episodes]
        if sum(option is not None for option in asked) != 1:
            raise ConfigError(
                "expected one of TASK, --check-photo PHOTO SCENE.yaml and --overlay-episodes RUN"
            )
        if self.check_photo is not None:
            return self._check_photo(*self.check_photo)
        if self.overlay_episodes is not None:
            return self._overlay_episodes(self.overlay_episodes)
        return self._sample(str(self.task))

    def _check_photo(self, photo: Path, scene: Path) -> Path:
        from codediffuser.datagen.sheets.photo_check import check_photo

        out = self.out or photo.with_name(f"{photo.stem}_check.png")
        console.print(check_photo(photo, scene, out).note)
        return out

    def _overlay_episodes(self, run: Path) -> Path:
        from codediffuser.datagen.sheets.episode_overlay import overlay_episodes

        for path in overlay_episodes(run, self.out):
            console.print(f"  {path}")
        return self.out or run

    def _sample(self, task_name: str) -> Path:
        from codediffuser.datagen.instructions.templates import load_templates
        from codediffuser.datagen.sampling_settings import SamplingSettings, parse_factors
        from codediffuser.datagen.scene_files import sample_scenes
        from codediffuser.datagen.scene_sampler import SceneSource
        from codediffuser.datagen.task import get_task

        if self.out is None:
            raise ConfigError(f"expected --out FOLDER for the scenes of {task_name}")
        if self.num_episodes < 1 or self.seed < 0:
            raise ConfigError(
                "expected --num-episodes of at least 1 and --seed of at least 0, "
                f"got {self.num_episodes} and {self.seed}"
            )
        task = get_task(task_name)
        library = load_templates(task.name, self.templates) if self.templates else None
        settings = SamplingSettings(
            root_seed=self.seed, variant=self.variant, split=self.split,
            template_split=None if self.template_split == "all" else self.template_split,
            picks=self.picks, places=self.places, stratify=parse_factors(self.stratify),
        )  # fmt: skip
        scenes = sample_scenes(
            SceneSource(task, settings, library), self.out, self.num_episodes,
            pictures=self.pictures, paper=self.paper,
            workers=self.workers, overwrite=self.overwrite,
        )  # fmt: skip
        for _ in track(scenes, "sample", self.num_episodes):
            pass
        return self.out
