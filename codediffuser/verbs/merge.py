"""`codediffuser merge`: several LeRobot datasets as one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.verbs.verb import Verb, track


@dataclass(kw_only=True)
class Merge(Verb):
    """Join LeRobot datasets of the same features: files are linked, their numbers rewritten.

    The first, middle and last frame of every episode are then decoded and compared with its source.

    Example: codediffuser merge runs/monday/lerobot runs/tuesday/lerobot --out runs/week
    """

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of two datasets or more, in the order of the result."""
    out: Path
    """Folder of the merged dataset."""
    workers: int = 1
    """Processes. Changes nothing but the time."""
    copy: bool = False
    """Copy files that stay the same instead of linking them."""
    no_verify: bool = False
    """Leave out the comparison with the sources."""
    overwrite: bool = False
    """Replace a dataset at --out."""

    def run(self) -> Path:
        """Merge and return the folder."""
        from codediffuser.datasets.merging.merge import merge_datasets

        steps = merge_datasets(
            self.datasets, self.out, workers=self.workers, link=not self.copy,
            verify=not self.no_verify, overwrite=self.overwrite,
        )  # fmt: skip
        for _ in track(steps, "merge", None):
            pass
        return self.out
