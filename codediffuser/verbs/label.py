"""`codediffuser label`: which object and which place each demonstration attends to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.errors import ConfigError, LabelError
from codediffuser.verbs.verb import Verb, console, track


@dataclass(kw_only=True)
class Label(Verb):
    """Label the attention of every episode in RUN/episodes.

    Example: codediffuser label runs/pack --auto --workers 2
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with episodes/."""
    auto: bool = False
    """Take the labels from the simulator's own knowledge."""
    workers: int = 1
    """Processes."""
    overwrite: bool = False
    """Replace labels that are there by a new revision; the history is kept."""

    def run(self) -> Path:
        """Label and return the folder of episodes."""
        from codediffuser.datagen.episode import list_episodes
        from codediffuser.labeling.auto import label_run

        if not self.auto:
            raise ConfigError(
                "label works from the simulator's states so far: add --auto "
                f"(codediffuser label {self.run_folder} --auto)"
            )
        results = label_run(self.run_folder, workers=self.workers, overwrite=self.overwrite)
        errors = []
        for result in track(results, "label", len(list_episodes(self.run_folder))):
            if result.error:
                errors.append(f"{result.episode_id}: {result.error}")
        for line in errors:
            console.print(line, markup=False)
        if errors:
            raise LabelError(f"{len(errors)} episodes got no labels; the first: {errors[0]}")
        return self.run_folder / "episodes"
