"""Index of a run's labels: one short row per episode, made from the label files alone.

Filters and reports over ten thousand episodes read one file instead of ten thousand. A row is made
again when its label file has another size or time, so the index may be deleted at any moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar, Literal

from codediffuser.datagen.episode import list_episodes, load_manifest
from codediffuser.errors import CodeDiffuserError
from codediffuser.labeling.label_document import LabelsDocument, Status
from codediffuser.labeling.store import LABELS, load_document
from codediffuser.schema import Document, Strict

LABELING = "labeling"
"""Folder of a run with what belongs to labeling as a whole: index, leases, drafts, report."""

INDEX = "index.json"
LOW_CONFIDENCE = 0.9

Filter = Literal[
    "all", "unlabeled", "flagged", "disagreeing", "low confidence",
    "second opinion", "to review", "rejected", "damaged",
]  # fmt: skip
"""Which episodes an operator walks through. `second opinion`: labelled by others alone."""


class IndexRow(Strict):
    """What the index knows of one episode."""

    episode_id: str
    task: str
    status: Status
    revision: int
    labelers: tuple[str, ...] = ()
    """Everybody whose revision is on record, in order of first saving."""
    confidence: float = 1.0
    """Of the target that is least sure."""
    disagrees: bool = False
    flags: tuple[str, ...] = ()
    """Reasons of open flags."""
    problem: str = ""
    """Why the label file cannot be read; empty when it can."""
    stamp: tuple[int, int] = (0, 0)
    """Time in ns and size of the label file that the row was made from; zeros for none."""

    def matches(self, wanted: Filter, operator: str) -> bool:
        """Whether the episode belongs to a filter, for one operator."""
        if self.problem:
            return wanted in ("all", "damaged")
        labeled = self.revision > 0
        match wanted:
            case "all":
                return True
            case "unlabeled":
                return self.status in ("unlabeled", "rejected") and not self.flags
            case "flagged":
                return bool(self.flags)
            case "disagreeing":
                return self.disagrees
            case "low confidence":
                return labeled and self.confidence < LOW_CONFIDENCE
            case "second opinion":
                return labeled and operator not in self.labelers
            case "to review":
                return self.status == "labeled"
            case "rejected":
                return self.status == "rejected"
            case "damaged":
                return False


class LabelIndex(Document):
    """Rows of all episodes of a run, sorted by id (`schema: codediffuser.label_index/1`)."""

    KIND: ClassVar[str] = "label_index"
    VERSION: ClassVar[int] = 1

    rows: tuple[IndexRow, ...]

    def ids(self, wanted: Filter = "all", operator: str = "") -> list[str]:
        """Ids of the episodes of a filter, in order."""
        return [row.episode_id for row in self.rows if row.matches(wanted, operator)]

    def count(self, *statuses: Status) -> int:
        """How many episodes have one of these statuses."""
        return sum(row.status in statuses for row in self.rows)


def load_index(run: Path) -> LabelIndex:
    """Bring the index of a run up to date and return it; it is written only when it has changed."""
    path = run / LABELING / INDEX
    try:
        old = LabelIndex.load(path)
    except CodeDiffuserError:
        old = LabelIndex(rows=())
    new = LabelIndex(rows=tuple(_rows(list_episodes(run), old.rows)))
    if new != old:
        new.save(path)
    return new


def index_row(folder: Path) -> IndexRow:
    """Read the row of one episode from its files."""
    stamp = _stamp(folder)
    try:
        task = load_manifest(folder).task
    except CodeDiffuserError as error:
        return _broken(folder, "", error, stamp)
    try:
        document = load_document(folder)
    except CodeDiffuserError as error:
        return _broken(folder, task, error, stamp)
    if document is None:
        return IndexRow(episode_id=folder.name, task=task, status="unlabeled", revision=0)
    return _row(folder.name, task, document, stamp)


def _rows(folders: Sequence[Path], known: Sequence[IndexRow]) -> Iterator[IndexRow]:
    by_id = {row.episode_id: row for row in known}
    for folder in folders:
        row = by_id.get(folder.name)
        yield row if row is not None and row.stamp == _stamp(folder) else index_row(folder)


def _row(
    episode_id: str, task: str, document: LabelsDocument, stamp: tuple[int, int]
) -> IndexRow:  # fmt: skip
    return IndexRow(
        episode_id=episode_id,
        task=task,
        status=document.status,
        revision=document.revision,
        labelers=tuple(document.latest_by_labeler()),
        confidence=min((e.provenance.confidence for e in document.labels), default=1.0),
        disagrees=document.disagrees,
        flags=tuple(flag.reason for flag in document.open_flags),
        stamp=stamp,
    )


def _broken(folder: Path, task: str, error: Exception, stamp: tuple[int, int]) -> IndexRow:
    return IndexRow(
        episode_id=folder.name, task=task, status="unlabeled", revision=0,
        problem=str(error), stamp=stamp,
    )  # fmt: skip


def _stamp(folder: Path) -> tuple[int, int]:
    try:
        found = (folder / LABELS).stat()
    except FileNotFoundError:
        return 0, 0
    return found.st_mtime_ns, found.st_size
