"""Which episodes of a run are exported, and which are left out for what reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from codediffuser.datagen.episode import list_episodes, load_manifest
from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.errors import CodeDiffuserError, DatasetError
from codediffuser.labeling.store import has_labels, load_document


@dataclass(frozen=True, slots=True)
class Choice:
    """Episodes of a run, sorted by what becomes of them."""

    chosen: Mapping[Path, EpisodeManifest]
    """By folder, in order of ids."""
    failed: Sequence[str] = ()
    """Ids of episodes that did not succeed."""
    rejected: Sequence[str] = ()
    """Ids of successful episodes that are left out since a reviewer rejected their labels."""
    with_rejected: bool = False
    """Whether such episodes are exported instead."""

    @property
    def summary(self) -> str:
        """How many episodes are exported and how many are not, in one line."""
        text = f"{len(self.chosen)} episodes"
        if self.failed:
            text += f"; left out: {len(self.failed)} that did not succeed"
        if self.rejected:
            text += (
                f"; left out: {len(self.rejected)} with rejected labels: {_listed(self.rejected)}"
            )
        return text


def choose_episodes(run: Path, *, needs_labels: bool = True, with_rejected: bool = False) -> Choice:
    """Successful episodes of a run whose labels nobody has rejected.

    Args:
        run: Run folder.
        needs_labels: Whether a run in which no episode has labels is an error. One in which only
            some have is always one.
        with_rejected: Whether rejected labels count like others.

    Raises:
        DatasetError: No episode is left, or some that succeeded have no labels; the message lists
            them.
    """
    manifests = {folder: load_manifest(folder) for folder in list_episodes(run)}
    succeeded = {folder: m for folder, m in manifests.items() if m.success}
    failed = [m.id for m in manifests.values() if not m.success]
    if not succeeded:
        raise DatasetError(
            f"{run}: {len(failed)} episodes, none of them successful; "
            f"run `codediffuser demo {run}` first"
        )
    rejected = [] if with_rejected else [f for f in succeeded if is_rejected(f)]
    chosen = {folder: m for folder, m in succeeded.items() if folder not in rejected}
    if not chosen:
        raise DatasetError(
            f"{run}: a reviewer rejected the labels of all {len(rejected)} successful episodes; "
            f"label them again with `codediffuser label {run}`, or give --with-rejected"
        )
    _require_labels(run, chosen, needs_labels)
    rates = sorted({m.hz for m in chosen.values()})
    if len(rates) > 1:
        raise DatasetError(f"{run}: episodes of several rates cannot share a dataset: {rates} Hz")
    return Choice(chosen, failed, [succeeded[folder].id for folder in rejected], with_rejected)


def is_rejected(folder: Path) -> bool:
    """Whether the latest review of an episode's present labels rejects them.

    Damaged labels count as not rejected: whoever reads them says what is wrong.
    """
    try:
        document = load_document(folder)
    except CodeDiffuserError:
        return False
    return document is not None and document.status == "rejected"


def _require_labels(run: Path, chosen: Mapping[Path, EpisodeManifest], needed: bool) -> None:
    bare = [m.id for folder, m in chosen.items() if not has_labels(folder)]
    if bare and (needed or len(bare) < len(chosen)):
        raise DatasetError(
            f"{run}: {len(bare)} of {len(chosen)} successful episodes have no labels: "
            f"{_listed(bare)}; run `codediffuser label {run} --auto`"
        )


def _listed(ids: Sequence[str]) -> str:
    return ", ".join(ids[:8]) + (f" and {len(ids) - 8} more" if len(ids) > 8 else "")
