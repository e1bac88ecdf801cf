"""What has been labelled, how fast, and how far labelers agree: numbers, and pictures of doubt."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import ClassVar

import numpy as np

from codediffuser.datagen.episode import list_episodes
from codediffuser.errors import CodeDiffuserError, EpisodeError
from codediffuser.files import write_bytes
from codediffuser.labeling.agreement import Agreement, agreement
from codediffuser.labeling.disagreement_picture import draw_disagreement
from codediffuser.labeling.index import LABELING, LOW_CONFIDENCE, LabelIndex, load_index
from codediffuser.labeling.label import ROLES, AttentionLabel
from codediffuser.labeling.label_document import LabelsDocument, Revision
from codediffuser.labeling.store import load_document, read_targets
from codediffuser.schema import Document, Strict

REPORT = "report"
REPORT_FILE = "report.json"


class LabelerCounts(Strict):
    """What one labeler did."""

    labeler: str
    revisions: int
    episodes: int
    minutes: float
    """Time that episodes were before the labeler's eyes; 0 for a program."""
    labels_per_minute: float | None
    """Targets per minute of that time; None where no time was taken."""
    prelabels: int
    """Revisions that began with a proposal."""


class PairAgreement(Strict):
    """Two labelers on the episodes that both labelled, by their last word each."""

    first: str
    second: str
    targets: int
    instance_accuracy: float
    """Share of targets for which both chose the same instance."""
    mean_chamfer_m: float
    """Mean symmetric Chamfer distance of the targets' points, not squared."""
    mean_iou: float


class LabelReport(Document):
    """What `RUN/labeling/report/report.json` says (`schema: codediffuser.label_report/1`)."""

    KIND: ClassVar[str] = "label_report"
    VERSION: ClassVar[int] = 1

    episodes: int
    unlabeled: int
    labeled: int
    accepted: int
    rejected: int
    flagged: int
    low_confidence: int
    damaged: dict[str, str]
    """Episodes whose labels cannot be read, and why."""
    flags: dict[str, int]
    """Reasons of open flags and how often each was given."""
    labelers: tuple[LabelerCounts, ...]
    agreement: tuple[PairAgreement, ...]
    disagreements: tuple[str, ...]
    """Episodes whose labelers disagree, not settled by a review; each has a picture."""


def write_report(run: Path) -> tuple[LabelReport, Path]:
    """Compute the report of a run and write it with its pictures.

    Returns:
        The report, and the folder that holds `report.json` and one PNG per disagreement.

    Raises:
        EpisodeError: The run has no episodes.
    """
    folders = {folder.name: folder for folder in list_episodes(run)}
    if not folders:
        raise EpisodeError(f"{run}: no episodes to report on; run `codediffuser demo {run}` first")
    index = load_index(run)
    documents: dict[str, LabelsDocument] = {}
    for name, folder in folders.items():
        try:
            document = load_document(folder)
        except CodeDiffuserError:
            continue  # The index says so.
        if document is not None:
            documents[name] = document
    report = _report(folders, documents, index)
    target = run / LABELING / REPORT
    target.mkdir(parents=True, exist_ok=True)
    for old in target.glob("*.png"):
        old.unlink()
    for name in report.disagreements:
        said = {
            by: read_targets(folders[name], revision.labels)
            for by, revision in documents[name].latest_by_labeler().items()
        }
        write_bytes(target / f"{name}.png", draw_disagreement(folders[name], said))
    report.save(target / REPORT_FILE)
    return report, target


def report_text(report: LabelReport) -> str:
    """The report for people, a few lines."""
    lines = [
        f"{report.episodes} episodes: {report.unlabeled} unlabeled, {report.labeled} labeled, "
        f"{report.accepted} accepted, {report.rejected} rejected, {report.flagged} flagged, "
        f"{report.low_confidence} of low confidence, {len(report.damaged)} damaged"
    ]
    for who in report.labelers:
        rate = who.labels_per_minute
        speed = f", {rate:.1f} labels a minute" if rate is not None else ""
        lines.append(f"  {who.labeler}: {who.episodes} episodes{speed}")
    for pair in report.agreement:
        lines.append(
            f"  {pair.first} and {pair.second}: {pair.targets} targets, same instance "
            f"{100 * pair.instance_accuracy:.1f} %, Chamfer {1000 * pair.mean_chamfer_m:.1f} mm, "
            f"IoU {pair.mean_iou:.3f}"
        )
    lines += [f"  flagged {count} x {reason}" for reason, count in report.flags.items()]
    if report.disagreements:
        lines.append(f"  labelers disagree on: {', '.join(report.disagreements)}")
    return "\n".join(lines)


def _report(
    folders: dict[str, Path], documents: dict[str, LabelsDocument], index: LabelIndex
) -> LabelReport:
    rows = index.rows
    reasons = Counter(reason for row in rows for reason in row.flags)
    return LabelReport(
        episodes=len(rows),
        unlabeled=sum(r.status == "unlabeled" and not r.problem for r in rows),
        labeled=index.count("labeled"),
        accepted=index.count("accepted"),
        rejected=index.count("rejected"),
        flagged=sum(bool(r.flags) for r in rows),
        low_confidence=sum(r.revision > 0 and r.confidence < LOW_CONFIDENCE for r in rows),
        damaged={r.episode_id: r.problem for r in rows if r.problem},
        flags=dict(reasons.most_common()),
        labelers=tuple(_labelers(list(documents.values()))),
        agreement=tuple(_pairs(folders, documents)),
        disagreements=tuple(name for name, d in documents.items() if d.disagrees),
    )


def _labelers(documents: Sequence[LabelsDocument]) -> Iterator[LabelerCounts]:
    by_labeler: dict[str, list[tuple[str, Revision]]] = defaultdict(list)
    for document in documents:
        for revision in document.revisions():
            by_labeler[_labeler(revision)].append((document.episode_id, revision))
    for name, work in sorted(by_labeler.items()):
        timed = [r for _, r in work if r.saved is not None and r.saved.seconds is not None]
        seconds = sum(r.saved.seconds or 0.0 for r in timed if r.saved is not None)
        targets = sum(len(r.labels) for r in timed)
        yield LabelerCounts(
            labeler=name,
            revisions=len(work),
            episodes=len({episode for episode, _ in work}),
            minutes=seconds / 60,
            labels_per_minute=60 * targets / seconds if seconds > 0 else None,
            prelabels=sum(r.saved is not None and r.saved.prelabel is not None for _, r in work),
        )


def _labeler(revision: Revision) -> str:
    return revision.saved.by if revision.saved else revision.labels[0].provenance.labeler


def _pairs(
    folders: dict[str, Path], documents: dict[str, LabelsDocument]
) -> Iterator[PairAgreement]:
    found: dict[tuple[str, str], list[Agreement]] = defaultdict(list)
    for name, document in documents.items():
        said: dict[str, tuple[AttentionLabel, ...]] = {
            by: read_targets(folders[name], revision.labels)
            for by, revision in document.latest_by_labeler().items()
        }
        for first, second in combinations(sorted(said), 2):
            for a, b, _ in zip(said[first], said[second], ROLES, strict=True):
                found[first, second].append(
                    agreement(a.instance_id, a.points_world, b.instance_id, b.points_world)
                )
    for (first, second), targets in sorted(found.items()):
        yield PairAgreement(
            first=first,
            second=second,
            targets=len(targets),
            instance_accuracy=float(np.mean([t.same_instance for t in targets])),
            mean_chamfer_m=float(np.mean([t.chamfer_m for t in targets])),
            mean_iou=float(np.mean([t.iou for t in targets])),
        )
