"""Labels on disk: `labels.json` and `labels.npz` in an episode's folder, whole pairs only.

```
RUN/episodes/000042/labels.json   targets, provenance, revision, and what earlier revisions said
RUN/episodes/000042/labels.npz    points of all these targets, each array named by its own SHA-256
```
Arrays are written before the JSON that names them, and the arrays that the older JSON names are
kept. A process killed in between thus leaves the older revision readable, and a pair that does not
belong together is found by the names.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from codediffuser.datagen.episode import load_manifest
from codediffuser.datagen.episode_format import LOG, STATES, EpisodeManifest
from codediffuser.errors import CodeDiffuserError, LabelError
from codediffuser.files import atomic_path, remove_partials
from codediffuser.labeling.label import ROLES, AttentionLabel, Provenance, Role
from codediffuser.pointcloud import check_points
from codediffuser.schema import Document, Strict

LABELS = "labels.json"
POINTS = "labels.npz"
REMEDY = "run `codediffuser label RUN --auto`, or choose the targets in the browser"


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


class Revision(Strict):
    """What an earlier revision said."""

    revision: int
    labels: tuple[LabelEntry, ...]


class LabelsDocument(Document):
    """What `labels.json` says (`schema: codediffuser.labels/1`)."""

    KIND: ClassVar[str] = "labels"
    VERSION: ClassVar[int] = 1

    episode_id: str
    episode_sha256: str
    """Content of the episode that the labels were set for, see `episode_sha256`."""
    revision: int = Field(ge=1)
    labels: tuple[LabelEntry, ...]
    history: tuple[Revision, ...] = ()
    """Earlier revisions, oldest first."""

    def entries(self) -> Iterator[LabelEntry]:
        """Targets of this revision and of all earlier ones."""
        yield from self.labels
        for earlier in self.history:
            yield from earlier.labels


@dataclass(frozen=True, slots=True)
class LabelSet:
    """The targets of one episode, as read from disk."""

    episode_id: str
    revision: int
    """Counts up with every change; give it to `save_labels` to notice other writers."""
    labels: tuple[AttentionLabel, ...]
    """One per role, in the order of `ROLES`."""
    document: LabelsDocument

    def __getitem__(self, role: Role) -> AttentionLabel:
        return self.labels[ROLES.index(role)]


def episode_sha256(manifest: EpisodeManifest) -> str:
    """What labels are bound to: the simulator states, or the log of a real recording.

    Pictures of a simulated episode can be made again with other cameras; its labels stay true.
    """
    return manifest.files[STATES if STATES in manifest.files else LOG].sha256


def has_labels(folder: Path) -> bool:
    """Whether an episode folder holds labels, sound or not."""
    return (folder / LABELS).exists()


def load_labels(folder: Path) -> LabelSet:
    """Read and check the labels of one episode.

    Raises:
        LabelError: There are none, they are damaged, or they belong to another episode.
        SchemaVersionError: They are of a version that this code cannot read.
    """
    document = _load_document(folder)
    arrays = _load_arrays(folder, {entry.points_sha256 for entry in document.labels})
    labels = tuple(_to_label(entry, arrays[entry.points_sha256]) for entry in document.labels)
    return LabelSet(document.episode_id, document.revision, labels, document)


def save_labels(
    folder: Path, labels: Sequence[AttentionLabel], *, expected_revision: int | None = None
) -> LabelSet:
    """Write the labels of one episode as its next revision; the same labels again change nothing.

    Args:
        folder: Episode folder, with its manifest.
        labels: Exactly one per role, each with points.
        expected_revision: The revision that the caller has seen, 0 for none. None takes whatever
            is there.

    Returns:
        What a reader gets from now on.

    Raises:
        LabelError: A role is missing or given twice, a label has no points, another writer came
            first, or the labels that are there are damaged or of another episode.
    """
    ordered = _one_per_role(labels, folder)
    manifest = load_manifest(folder)
    with _locked(folder):
        remove_partials(folder)
        old = _load_document(folder) if has_labels(folder) else None
        found = old.revision if old else 0
        if expected_revision is not None and expected_revision != found:
            raise LabelError(
                f"{folder / LABELS}: revision {found} is there, {expected_revision} was expected: "
                "someone else changed these labels; load them again and repeat the change"
            )
        new = {points_sha256(label.points_world): label.points_world for label in ordered}
        entries = tuple(_to_entry(label) for label in ordered)
        if old is None or entries != old.labels:
            kept: dict[str, np.ndarray] = {}
            history: tuple[Revision, ...] = ()
            if old is not None:
                kept = _load_arrays(folder, {entry.points_sha256 for entry in old.entries()})
                history = (*old.history, Revision(revision=found, labels=old.labels))
            _write_arrays(folder / POINTS, {**kept, **new})
            LabelsDocument(
                episode_id=manifest.id,
                episode_sha256=episode_sha256(manifest),
                revision=found + 1,
                labels=entries,
                history=history,
            ).save(folder / LABELS)
    return load_labels(folder)


def points_sha256(points_world: np.ndarray) -> str:
    """Name of an array of points: SHA-256 of its numbers as little-endian float32."""
    return hashlib.sha256(np.ascontiguousarray(points_world, dtype="<f4").tobytes()).hexdigest()


def _load_document(folder: Path) -> LabelsDocument:
    path = folder / LABELS
    if not path.exists():
        raise LabelError(f"{folder}: this episode has no labels; {REMEDY}")
    manifest = load_manifest(folder)
    document = LabelsDocument.load(path)
    found, expected = document.episode_sha256, episode_sha256(manifest)
    if found != expected:
        raise LabelError(
            f"{path}: these labels belong to episode '{document.episode_id}' ({found[:12]}), "
            f"the folder holds '{manifest.id}' ({expected[:12]}); delete {LABELS}, then {REMEDY}"
        )
    roles = [entry.role for entry in document.labels]
    if roles != list(ROLES):
        raise LabelError(f"{path}: expected one label for each of {ROLES}, got {tuple(roles)}")
    return document


def _load_arrays(folder: Path, names: set[str]) -> dict[str, np.ndarray]:
    path = folder / POINTS
    hint = f"delete {LABELS} and {POINTS} there, then {REMEDY}"
    try:
        with np.load(path, allow_pickle=False) as raw:
            missing = sorted(names - set(raw.files))
            if missing:
                raise LabelError(
                    f"{path}: lacks the points {missing[0][:12]} that {LABELS} names; {hint}"
                )
            arrays = {name: raw[name] for name in sorted(names)}
    except FileNotFoundError:
        raise LabelError(f"{path}: no such file, but {LABELS} names points in it; {hint}") from None
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise LabelError(f"{path}: damaged: {error}; {hint}") from None
    for name, points in arrays.items():
        if points_sha256(points) != name:
            raise LabelError(f"{path}: the points {name[:12]} are not what they were; {hint}")
    return arrays


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    with atomic_path(path) as partial, partial.open("wb") as stream:
        ordered: dict[str, Any] = {name: arrays[name].astype("<f4") for name in sorted(arrays)}
        np.savez(stream, **ordered)


def _one_per_role(labels: Sequence[AttentionLabel], folder: Path) -> tuple[AttentionLabel, ...]:
    by_role = {label.role: label for label in labels}
    if len(labels) != len(ROLES) or set(by_role) != set(ROLES):
        raise LabelError(
            f"{folder}: expected one label for each of {ROLES}, got "
            f"{tuple(label.role for label in labels)}"
        )
    for label in labels:
        try:
            check_points(label.points_world)
        except CodeDiffuserError as error:
            raise LabelError(f"{folder}: {label.role} label: {error}") from None
        if len(label.points_world) == 0 or not np.isfinite(label.points_world).all():
            raise LabelError(
                f"{folder}: the {label.role} label has no points, or not-a-number ones"
            )
    return tuple(by_role[role] for role in ROLES)


def _to_entry(label: AttentionLabel) -> LabelEntry:
    return LabelEntry(
        role=label.role,
        category=label.category,
        instance_id=label.instance_id,
        follows=label.follows,
        provenance=ProvenanceEntry(**asdict(label.provenance)),
        num_points=len(label.points_world),
        points_sha256=points_sha256(label.points_world),
    )


def _to_label(entry: LabelEntry, points_world: np.ndarray) -> AttentionLabel:
    return AttentionLabel(
        role=entry.role,
        category=entry.category,
        instance_id=entry.instance_id,
        points_world=points_world,
        follows=entry.follows,
        provenance=Provenance(**entry.provenance.model_dump()),
    )


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One writer per episode folder at a time, on one machine."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
