"""What people say about an episode's labels: flags that something is wrong, and reviews."""

from __future__ import annotations

from pathlib import Path

from codediffuser.errors import LabelError
from codediffuser.labeling.label_document import Flag, LabelsDocument, Review, Verdict
from codediffuser.labeling.store import REMEDY, change_document, expect_revision


def add_flag(folder: Path, reason: str, *, by: str, at: str) -> LabelsDocument:
    """Note that something is wrong with an episode, labelled or not."""
    flag = Flag(reason=reason, by=by, at=at)
    return change_document(
        folder, lambda old: old.model_copy(update={"flags": (*old.flags, flag)})
    )  # fmt: skip


def withdraw_flags(folder: Path, *, by: str, at: str) -> LabelsDocument:
    """Withdraw every open flag of an episode; they stay on record."""
    gone = {"withdrawn_by": by, "withdrawn_at": at}

    def withdraw(old: LabelsDocument) -> LabelsDocument:
        flags = tuple(f.model_copy(update=gone) if f.open else f for f in old.flags)
        return old.model_copy(update={"flags": flags})

    return change_document(folder, withdraw)


def add_review(
    folder: Path, verdict: Verdict, comment: str, *, by: str, at: str, expected_revision: int
) -> LabelsDocument:
    """Accept or reject the revision that the reviewer has seen.

    Raises:
        StaleLabelError: Another revision is there by now.
        LabelError: There are no labels to judge, or they are damaged.
    """

    def judge(old: LabelsDocument) -> LabelsDocument:
        expect_revision(folder, old, expected_revision)
        if old.revision == 0:
            raise LabelError(f"{folder}: there are no labels to review; {REMEDY}")
        review = Review(revision=old.revision, verdict=verdict, comment=comment, by=by, at=at)
        return old.model_copy(update={"reviews": (*old.reviews, review)})

    return change_document(folder, judge)
