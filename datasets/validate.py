"""Is what lies on disk what it says? Runs, episodes and datasets, with one report for all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode import Episode, list_episodes, load_manifest
from codediffuser.datagen.episode_check import Finding, check_episode
from codediffuser.datagen.episode_format import EPISODES, MANIFEST, STATES
from codediffuser.datasets.dataset_check import check_dataset
from codediffuser.datasets.export_meta import INFO, find_document
from codediffuser.errors import CodeDiffuserError, ConfigError, DatasetError
from codediffuser.files import TEMPORARY_PREFIX, sha256_file
from codediffuser.labeling.label import AttentionLabel
from codediffuser.labeling.store import LABELS, episode_sha256, has_labels, load_labels

LABEL_REMEDY = "run `codediffuser label RUN --auto --overwrite`, or choose the targets again"
FAR_FROM_OBJECT_M = 0.25


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
        yield from _check_labelled(path)
    elif (path / EPISODES).is_dir() or (path / "scenes").is_dir():
        yield from _check_run(path)
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
        lines += [f"  {finding.where}: {finding.what}", f"    -> {finding.remedy}"]
    return "\n".join(lines)


def _check_run(run: Path) -> Iterator[Finding]:
    for place in (run, run / EPISODES, run / "scenes"):
        for leftover in sorted(place.glob(f"{TEMPORARY_PREFIX}*")):
            what = "left behind by a process that was killed, or is still at work"
            yield Finding(str(leftover), what, "run the same command again, it cleans up")
    folders = list_episodes(run)
    labelled = [folder for folder in folders if has_labels(folder)]
    for folder in folders:
        yield from _check_labelled(folder)
        if labelled and not has_labels(folder):
            yield Finding(str(folder), "no labels, though other episodes have some", LABEL_REMEDY)
    export = run / "lerobot"
    if (export / INFO).exists():
        yield from check_dataset(export)
        yield from _check_export_is_current(run, export)


def _check_labelled(folder: Path) -> Iterator[Finding]:
    """One episode: its files, then its labels if it has some."""
    found = check_episode(folder)
    yield from found
    if found or not has_labels(folder):
        return
    where = str(folder / LABELS)
    try:
        labels = load_labels(folder).labels
        episode = Episode.open(folder)
        for label in labels:
            for what in _label_faults(label, episode):
                yield Finding(where, f"{label.role} label: {what}", LABEL_REMEDY)
    except CodeDiffuserError as error:
        yield Finding(where, str(error), LABEL_REMEDY)


def _label_faults(label: AttentionLabel, episode: Episode) -> Iterator[str]:
    if STATES not in episode.manifest.files:
        return
    objects = {o.id for o in episode.scene.objects}
    known = objects if label.role == "pick" else {p.id for p in episode.scene.places}
    if label.provenance.source == "simulator":
        if label.instance_id not in known:
            yield f"'{label.instance_id}' is not in the scene; it has: {', '.join(sorted(known))}"
        target = episode.scene.target
        wanted = target.pick if label.role == "pick" else target.place
        if label.instance_id != wanted:
            yield f"'{label.instance_id}' is not the scene's target '{wanted}'"
    if label.follows is None:
        return
    if label.follows not in episode.trajectory.object_ids:
        yield f"follows '{label.follows}', which does not move in this episode"
        return
    origin = episode.trajectory.T_world_object(label.follows, 0)[:3, 3]
    distance = float(np.linalg.norm(label.points_world - origin, axis=1).min())
    if distance > FAR_FROM_OBJECT_M:
        yield f"its points lie {distance:.2f} m from '{label.follows}', which carries them"


def _check_export_is_current(run: Path, export: Path) -> Iterator[Finding]:
    """Whether a run's dataset holds the run's episodes and labels of now."""
    try:
        document = find_document(export)
    except ConfigError:
        return
    if document is None:
        return
    remedy = f"run `codediffuser convert {run}` again"
    manifests = {m.id: (f, m) for f in list_episodes(run) if (m := load_manifest(f)).success}
    exported = {e.episode_id: e for e in document.episodes}
    for name in sorted(set(manifests) ^ set(exported)):
        what = "is not in the run" if name in exported else "is not in the dataset"
        yield Finding(str(export), f"episode {name} {what}", remedy)
    for name in sorted(set(manifests) & set(exported)):
        folder, manifest = manifests[name]
        if episode_sha256(manifest) != exported[name].episode_sha256:
            yield Finding(str(export), f"episode {name} was another one when converted", remedy)
        elif not has_labels(folder) or (
            sha256_file(folder / LABELS) != exported[name].labels_sha256
        ):
            what = f"the labels of episode {name} changed since they were converted"
            yield Finding(str(export), what, remedy)
