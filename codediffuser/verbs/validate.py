"""`codediffuser validate`: whether what lies on disk is what it says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.errors import FindingsError
from codediffuser.verbs.verb import Verb, track


@dataclass(kw_only=True)
class Validate(Verb):
    """Check a run or a LeRobot dataset: hashes, counts, times, pictures, labels, statistics.

    Nothing is changed. Exits with 3 when something is wrong; docs/keeping.md lists what is found.

    Example: codediffuser validate runs/pack --json findings.json
    """

    path: tyro.conf.Positional[Path]
    """Run folder, folder of an episode, or folder of a dataset."""
    json: Path | None = None
    """Write all findings to this file as well, for programs."""

    def run(self) -> str:
        """Return the report; findings exit with 3."""
        from codediffuser.datasets.validate import as_json, report, validate
        from codediffuser.files import write_json

        findings = list(track(validate(self.path), "findings", None))
        if self.json is not None:
            write_json(self.json, as_json(self.path, findings))
        if findings:
            raise FindingsError(report(self.path, findings))
        return report(self.path, findings)
