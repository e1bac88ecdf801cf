"""Is what lies on disk what it says? Runs, episodes and datasets, with one report for all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from codediffuser.datagen.episode_check import Finding
from codediffuser.datagen.episode_format import EPISODES, MANIFEST
from codediffuser.datasets.checks.dataset import check_dataset
from codediffuser.datasets.checks.run import check_labelled, check_run
from codediffuser.datasets.export_meta import INFO
from codediffuser.errors import DatasetError


def validate(path: Path) -> Iterator[Finding]:
    """Check a run, an episode or a dataset, whichever lies at `path`.

    A run's export is checked too, and that it was made from the episodes and labels of now.

    Yields:
        What is wrong, as it is found; nothing when all is well.

    Raises:
        DatasetError: There is nothing at `path` that could be checked.
        SchemaVersionError: A dataset is of a version that this code cannot read.
    """
    if (path / INFO).exists():
        yield from check_dataset(path)
    elif (path / MANIFEST).exists():
        yield from check_labelled(path)
    elif (path / EPISODES).is_dir() or (path / "scenes").is_dir():
        yield from check_run(path)
    else:
        raise DatasetError(
            f"{path}: nothing to validate; expected a run with {EPISODES}/, an episode with "
            f"{MANIFEST}, or a LeRobot dataset with {INFO}"
        )


def report(path: Path, findings: Sequence[Finding]) -> str:
    """What was found, as text for people: one line each, with the remedy below."""
    if not findings:
        return f"{path}: nothing wrong"
    lines = [f"{path}: {len(findings)} finding{'s' if len(findings) > 1 else ''}"]
    for finding in findings:
        lines += [f"  {finding.where}: {finding.what} [{finding.kind}]"]
        lines += [f"    -> {finding.remedy}"]
    return "\n".join(lines)


def as_json(path: Path, findings: Sequence[Finding]) -> dict[str, Any]:
    """What was found, for programs: `schema: codediffuser.findings/1`, counts by kind, and all."""
    return {
        "schema": "codediffuser.findings/1",
        "path": str(path),
        "kinds": dict(sorted(Counter(finding.kind for finding in findings).items())),
        "findings": [asdict(finding) for finding in findings],
    }
