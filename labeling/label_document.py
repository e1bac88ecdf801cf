"""What `labels.json` says: targets, who set them, what was said before, flags and reviews.

Version 2 adds to version 1 who saved each revision and how long it took, flags, and reviews.
Version 1 files are read; only version 2 is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import ClassVar, Literal

from pydantic import Field

from codediffuser.labeling.label import Role
from codediffuser.schema import Document, Raw, Strict

Status = Literal["unlabeled", "labeled", "accepted", "rejected"]
Verdict = Literal["accept", "reject"]


class ProvenanceEntry(Strict):
    """`Provenance` on disk."""

    source: Literal["simulator", "human", "features", "program"]
    labeler: str
    tool_version: str
    confidence: float = Field(ge=0.0, le=1.0)
    created_at: str | None


class LabelEntry(Strict):
    """One target on disk; its points are the array `points_sha256` of `labels.npz`."""

    role: Role
    category: str
    instance_id: str
    follows: str | None
    provenance: ProvenanceEntry
    num_points: int
    points_sha256: str

    def says_the_same(self, other: LabelEntry) -> bool:
        """Whether two entries differ in nothing but the time they were made."""
        return self._timeless() == other._timeless()

    def _timeless(self) -> LabelEntry:
        untimed = self.provenance.model_copy(update={"created_at": None})
        return self.model_copy(update={"provenance": untimed})


class Saving(Strict):
    """Who saved a revision. Absent for labels that a program makes the same way at any time."""

    by: str
    at: str
    """ISO 8601, UTC."""
    seconds: float | None = Field(default=None, ge=0.0)
    """How long the episode was before the labeler's eyes."""
    prelabel: str | None = None
    """Where the proposal came from that the labeler accepted or corrected."""


class Revision(Strict):
    """What an earlier revision said."""

    revision: int
    labels: tuple[LabelEntry, ...]
    saved: Saving | None = None


class Flag(Strict):
    """Somebody says that something is wrong with the episode. A withdrawn one stays on record."""

    reason: str
    by: str
    at: str
    withdrawn_by: str | None = None
    withdrawn_at: str | None = None

    @property
    def open(self) -> bool:
        """Whether it still stands."""
        return self.withdrawn_by is None


class Review(Strict):
    """A judgement of one revision."""

    revision: int
    verdict: Verdict
    comment: str
    by: str
    at: str


def _lift_1_to_2(raw: Raw) -> Raw:
    history = [{**revision, "saved": None} for revision in raw.get("history", ())]
    return {**raw, "saved": None, "history": history, "flags": [], "reviews": []}


class LabelsDocument(Document):
    """What `labels.json` says (`schema: codediffuser.labels/2`)."""

    KIND: ClassVar[str] = "labels"
    VERSION: ClassVar[int] = 2
    UPGRADES: ClassVar[dict[int, Callable[[Raw], Raw]]] = {1: _lift_1_to_2}

    episode_id: str
    episode_sha256: str
    """Content of the episode that the labels were set for, see `store.episode_sha256`."""
    revision: int = Field(ge=0)
    """Counts the sets of labels; 0 while there is nothing but flags."""
    labels: tuple[LabelEntry, ...]
    """One per role in the order of `ROLES`; empty at revision 0."""
    saved: Saving | None = None
    history: tuple[Revision, ...] = ()
    """Earlier revisions, oldest first."""
    flags: tuple[Flag, ...] = ()
    reviews: tuple[Review, ...] = ()

    @property
    def status(self) -> Status:
        """Where the episode stands, by the latest review of its present revision."""
        if self.revision == 0:
            return "unlabeled"
        verdicts = [r.verdict for r in self.reviews if r.revision == self.revision]
        if not verdicts:
            return "labeled"
        return "accepted" if verdicts[-1] == "accept" else "rejected"

    @property
    def open_flags(self) -> tuple[Flag, ...]:
        """Flags that still stand."""
        return tuple(flag for flag in self.flags if flag.open)

    def revisions(self) -> Iterator[Revision]:
        """All revisions, oldest first, the present one last; none at revision 0."""
        yield from self.history
        if self.revision:
            yield Revision(revision=self.revision, labels=self.labels, saved=self.saved)

    def entries(self) -> Iterator[LabelEntry]:
        """Targets of this revision and of all earlier ones."""
        for revision in self.revisions():
            yield from revision.labels

    def latest_by_labeler(self) -> dict[str, Revision]:
        """The last revision of each person or program that saved one, in order of first saving.

        A revision without `saved` counts for the labeler of its first target.
        """
        latest: dict[str, Revision] = {}
        for revision in self.revisions():
            entry = revision.labels[0].provenance.labeler
            latest[revision.saved.by if revision.saved else entry] = revision
        return latest

    @property
    def disagrees(self) -> bool:
        """Whether the labelers' last words name different targets, and no review has settled it."""
        said = {
            tuple(entry.instance_id for entry in revision.labels)
            for revision in self.latest_by_labeler().values()
        }
        return len(said) > 1 and self.status != "accepted"
