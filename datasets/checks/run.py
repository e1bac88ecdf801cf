"""Is a run whole? Its scenes, episodes, labels, and whether its export is made of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from codediffuser.datagen.demo_results import failure_path
from codediffuser.datagen.episode import Episode, list_episodes, load_manifest
from codediffuser.datagen.episode_check import Finding, check_episode
from codediffuser.datagen.episode_format import EPISODES, STATES
from codediffuser.datasets.checks.dataset import check_dataset
from codediffuser.datasets.export_meta import INFO, ExportedEpisode, find_document
from codediffuser.datasets.exporting.choice import is_rejected
from codediffuser.datasets.exporting.source import labels_sha256
from codediffuser.errors import CodeDiffuserError, ConfigError
from codediffuser.files import TEMPORARY_PREFIX
from codediffuser.labeling.label import AttentionLabel
from codediffuser.labeling.store import LABELS, episode_sha256, has_labels, load_labels

LABEL_REMEDY = "run `codediffuser label RUN --auto --overwrite`, or choose the targets again"
FAR_FROM_OBJECT_M = 0.25


def check_run(run: Path) -> Iterator[Finding]:
    """Check a run folder: leftovers, scenes, episodes with their labels, and the export."""
    for place in (run, run / EPISODES, run / "scenes"):
        for leftover in sorted(place.glob(f"{TEMPORARY_PREFIX}*")):
            what = "left behind by a process that was killed, or is still at work"
            remedy = "run the same command again, it cleans up"
            yield Finding("run.leftover", str(leftover), what, remedy)
    folders = list_episodes(run)
    yield from _check_scenes(run, folders)
    yield from _check_duplicates(folders)
    labelled = [folder for folder in folders if has_labels(folder)]
    for folder in folders:
        yield from check_labelled(folder)
        if labelled and not has_labels(folder):
            what = "no labels, though other episodes have some"
            yield Finding("label.missing", str(folder), what, LABEL_REMEDY)
    export = run / "lerobot"
    if (export / INFO).exists():
        yield from check_dataset(export)
        yield from _check_export_is_current(run, export)


def _check_scenes(run: Path, folders: list[Path]) -> Iterator[Finding]:
    """Once demonstrations were made, each scene has an episode or a reason why not."""
    if not folders:
        return
    there = {folder.name for folder in folders}
    for path in sorted((run / "scenes").glob("*.yaml")):
        if path.stem not in there and not failure_path(run, path.stem).exists():
            what = "has neither an episode nor a recorded failure"
            yield Finding("run.scene-open", str(path), what, f"run `codediffuser demo {run}` again")


def _check_duplicates(folders: list[Path]) -> Iterator[Finding]:
    """The same recording twice would train and validate at once."""
    seen: dict[str, Path] = {}
    for folder in folders:
        try:
            content = episode_sha256(load_manifest(folder))
        except (CodeDiffuserError, KeyError):
            continue  # told by `check_episode`
        if content in seen:
            what = f"is the same recording as {seen[content].name}"
            yield Finding("run.duplicate", str(folder), what, "delete one of them")
        seen.setdefault(content, folder)


def check_labelled(folder: Path) -> Iterator[Finding]:
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
                yield Finding("label.scene", where, f"{label.role} label: {what}", LABEL_REMEDY)
    except CodeDiffuserError as error:
        yield Finding("label.damaged", where, str(error), LABEL_REMEDY)


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
    manifests = {}
    for folder in list_episodes(run):
        with contextlib.suppress(CodeDiffuserError):  # told by `check_episode`
            manifest = load_manifest(folder)
            if manifest.success:
                manifests[manifest.id] = (folder, manifest)
    exported = {e.episode_id: e for e in document.episodes}
    away = {name for name in document.rejected if is_rejected(run / EPISODES / name)}
    for name in sorted((set(manifests) ^ set(exported)) - away):
        what = "is not in the run" if name in exported else "is not in the dataset"
        yield Finding("export.episodes", str(export), f"episode {name} {what}", remedy)
    for name in sorted(set(manifests) & set(exported)):
        folder, manifest = manifests[name]
        if episode_sha256(manifest) != exported[name].episode_sha256:
            what = f"episode {name} was another one when converted"
            yield Finding("export.outdated", str(export), what, remedy)
        elif _other_labels(folder, exported[name]):
            what = f"the labels of episode {name} changed since they were converted"
            yield Finding("export.outdated", str(export), what, remedy)
        elif is_rejected(folder) and not document.with_rejected:
            what = f"a reviewer rejected the labels of episode {name}, which was converted before"
            yield Finding("export.outdated", str(export), what, remedy)


def _other_labels(folder: Path, exported: ExportedEpisode) -> bool:
    if not has_labels(folder):
        return True
    try:
        return labels_sha256(folder) != exported.labels_sha256
    except CodeDiffuserError:  # told by `check_labelled`
        return True
