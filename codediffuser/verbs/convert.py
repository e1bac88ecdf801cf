"""`codediffuser convert`: episodes and labels to a LeRobot dataset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from codediffuser.verbs.verb import Verb, track


@dataclass(kw_only=True)
class Convert(Verb):
    """Export the successful, labelled episodes of RUN as a LeRobot v3 dataset.

    The clouds that are finished are kept, so a convert that was cut off continues; the dataset
    itself appears whole.

    Example: codediffuser convert runs/pack --profile pointcloud --workers 2
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with labelled episodes/."""
    out: Path | None = None
    """Folder of the dataset. Default: RUN/lerobot."""
    profile: Literal["pointcloud"] = "pointcloud"
    """What goes into a frame. pointcloud: a cloud of 512 points with attention, state, action."""
    workers: int = 1
    """Processes. The same bytes for any number."""
    overwrite: bool = False
    """Replace a folder at --out that no convert wrote."""

    def run(self) -> Path:
        """Convert and return the folder of the dataset."""
        from codediffuser.datasets.convert import choose_episodes, convert_run

        total = len(choose_episodes(self.run_folder)[0])
        work = convert_run(
            self.run_folder, self.out, profile=self.profile,
            workers=self.workers, overwrite=self.overwrite,
        )  # fmt: skip
        for _ in track(work, "convert", total):
            pass
        return self.out or self.run_folder / "lerobot"
