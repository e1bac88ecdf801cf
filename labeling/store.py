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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.datagen.episode import load_manifest
from codediffuser.datagen.episode_format import LOG, STATES, EpisodeManifest
from codediffuser.errors import CodeDiffuserError, LabelError, StaleLabelError
from codediffuser.files import atomic_path, remove_partials
from codediffuser.labeling.label import ROLES, AttentionLabel, Provenance, Role
from codediffuser.labeling.label_document import (
    LabelEntry,
    LabelsDocument,
    ProvenanceEntry,
    Saving,
)
from codediffuser.pointcloud import check_points

LABELS = "labels.json"
POINTS = "labels.npz"
REMEDY = "run `codediffuser label RUN --auto`, or choose the targets in the browser"


@dataclass(frozen=True, slots=True)
class LabelSet:
    """The targets of one episode, as read from disk."""

    episode_id: str
    revision: int
    """Counts the sets of labels; give it to `save_labels` to notice other writers."""
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
    """Whether an episode folder holds labels, sound or not; flags alone are none."""
    if not (folder / LABELS).exists():
        return False
    try:
        return LabelsDocument.load(folder / LABELS).revision > 0
    except CodeDiffuserError:
        return True


def load_labels(folder: Path) -> LabelSet:
    """Read and check the labels of one episode.

    Raises:
        LabelError: There are none, they are damaged, or they belong to another episode.
        SchemaVersionError: They are of a version that this code cannot read.
    """
    document = load_document(folder)
    if document is None or document.revision == 0:
        raise LabelError(f"{folder}: this episode has no labels; {REMEDY}")
    return LabelSet(
        document.episode_id,
        document.revision,
        read_targets(folder, document.labels),
        document,
    )


def load_document(folder: Path) -> LabelsDocument | None:
    """Read and check `labels.json` alone; None when nobody has labelled or flagged the episode.

    Raises:
        LabelError: It is damaged or belongs to another episode.
        SchemaVersionError: It is of a version that this code cannot read.
    """
    path = folder / LABELS
    if not path.exists():
        return None
    manifest = load_manifest(folder)
    document = LabelsDocument.load(path)
    found, expected = document.episode_sha256, episode_sha256(manifest)
    if found != expected:
        raise LabelError(
            f"{path}: these labels belong to episode '{document.episode_id}' ({found[:12]}), "
            f"the folder holds '{manifest.id}' ({expected[:12]}); delete {LABELS}, then {REMEDY}"
        )
    for revision in document.revisions():
        roles = tuple(entry.role for entry in revision.labels)
        if roles != ROLES:
            raise LabelError(f"{path}: expected one label for each of {ROLES}, got {roles}")
    return document


def read_targets(folder: Path, entries: Sequence[LabelEntry]) -> tuple[AttentionLabel, ...]:
    """Targets of any revision, with their points.

    Raises:
        LabelError: The points are missing or damaged.
    """
    arrays = load_arrays(folder, {entry.points_sha256 for entry in entries})
    return tuple(_to_label(entry, arrays[entry.points_sha256]) for entry in entries)


def save_labels(
    folder: Path,
    labels: Sequence[AttentionLabel],
    *,
    expected_revision: int | None = None,
    saved: Saving | None = None,
) -> LabelSet:
    """Write the labels of one episode as its next revision; the same labels again change nothing.

    Labels that differ only in the time they were made are the same.

    Args:
        folder: Episode folder, with its manifest.
        labels: Exactly one per role, each with points.
        expected_revision: The revision that the caller has seen, 0 for none. None takes whatever
            is there.
        saved: Who saves; None for labels that a program makes the same way at any time.

    Returns:
        What a reader gets from now on.

    Raises:
        StaleLabelError: Another writer came first.
        LabelError: A role is missing or given twice, a label has no points, or the labels that
            are there are damaged or of another episode.
    """
    ordered = _one_per_role(labels, folder)
    entries = tuple(_to_entry(label) for label in ordered)

    def next_revision(old: LabelsDocument) -> LabelsDocument:
        expect_revision(folder, old, expected_revision)
        pairs = zip(entries, old.labels, strict=True) if old.labels else ()
        if old.labels and all(new.says_the_same(was) for new, was in pairs):
            return old
        present = {"revision": old.revision + 1, "labels": entries, "saved": saved}
        return old.model_copy(update={**present, "history": tuple(old.revisions())})

    new = {points_sha256(label.points_world): label.points_world for label in ordered}
    change_document(folder, next_revision, new)
    return load_labels(folder)


def change_document(
    folder: Path,
    change: Callable[[LabelsDocument], LabelsDocument],
    points: Mapping[str, np.ndarray] | None = None,
) -> LabelsDocument:
    """Replace the labels of an episode by what `change` makes of them, one writer at a time.

    Args:
        folder: Episode folder, with its manifest.
        change: Gets the document on disk, or an empty one at revision 0. Returning it as it is
            writes nothing.
        points: Arrays by name that the new document refers to beside those that are there.

    Raises:
        LabelError: What is there is damaged or of another episode; also whatever `change` raises.
    """
    manifest = load_manifest(folder)
    with _locked(folder):
        remove_partials(folder)
        old = load_document(folder) or LabelsDocument(
            episode_id=manifest.id, episode_sha256=episode_sha256(manifest), revision=0, labels=()
        )
        new = change(old)
        if new == old:
            return old
        if points:
            kept = load_arrays(folder, {entry.points_sha256 for entry in old.entries()})
            _write_arrays(folder / POINTS, {**kept, **points})
        new.save(folder / LABELS)
        return new


def points_sha256(points_world: np.ndarray) -> str:
    """Name of an array of points: SHA-256 of its numbers as little-endian float32."""
    return hashlib.sha256(np.ascontiguousarray(points_world, dtype="<f4").tobytes()).hexdigest()


def load_arrays(folder: Path, names: set[str]) -> dict[str, np.ndarray]:
    """Read and check arrays of points by their names.

    Raises:
        LabelError: One is missing or not what it was, or the file is damaged.
    """
    if not names:
        return {}
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


def expect_revision(folder: Path, found: LabelsDocument, expected_revision: int | None) -> None:
    """Notice another writer.

    Args:
        folder: Episode folder, for the message.
        found: What is there.
        expected_revision: What the caller has seen; None takes whatever is there.

    Raises:
        StaleLabelError: Another revision is there.
    """
    if expected_revision is None or expected_revision == found.revision:
        return
    by = f" by {found.saved.by}" if found.saved else ""
    raise StaleLabelError(
        f"{folder / LABELS}: revision {found.revision}{by} is there, {expected_revision} was "
        "expected: someone else changed these labels; load them again and repeat the change"
    )


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
