"""`codediffuser validate`: whether what lies on disk is what it says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.errors import FindingsError
from codediffuser.verbs.verb import Verb


@dataclass(kw_only=True)
class Validate(Verb):
    """Check a run folder or a LeRobot dataset: hashes, counts, times, labels, statistics.

    Example: codediffuser validate runs/pack
    """

    path: tyro.conf.Positional[Path]
    """Run folder, or folder of a dataset."""

    def run(self) -> str:
        """Return the report; findings exit with 3."""
        from codediffuser.datasets.validate import report, validate

        findings = list(validate(self.path))
        if findings:
            raise FindingsError(report(self.path, findings))
        return report(self.path, findings)
