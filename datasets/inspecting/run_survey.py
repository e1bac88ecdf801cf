"""Surveys of run folders, from manifests, scenes and labels; pictures are not opened."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from codediffuser.datagen.demo_results import FAILURES, DemoFailure
from codediffuser.datagen.episode import Episode, list_episodes, load_manifest
from codediffuser.datagen.episode_format import EPISODES, LOG, SCENE, STATES, EpisodeManifest
from codediffuser.datagen.scene import SCENES, SceneSpec
from codediffuser.datasets.inspecting.survey import (
    NOT_RECORDED,
    SUCCESS,
    EpisodeFacts,
    FeatureFacts,
    LabelFacts,
    Motion,
    Survey,
    bytes_below,
    resample,
    spread,
)
from codediffuser.errors import CodeDiffuserError, EpisodeError
from codediffuser.labeling.store import LABELS, POINTS, load_document

PARTS = {"raw logs": LOG, "simulator states": STATES, "labels": LABELS, "label points": POINTS}
"""Files of an episode by what the size table calls them."""


def survey_run(run: Path) -> Survey:
    """Read what a run holds. Damaged episodes are named in `remarks` and left out.

    Raises:
        EpisodeError: There is no readable episode.
    """
    folders, remarks, found = list_episodes(run), [], []
    manifests: list[EpisodeManifest] = []
    for folder in folders:
        try:
            manifest = load_manifest(folder)
            found.append(_episode(folder, manifest))
            manifests.append(manifest)
        except CodeDiffuserError as error:
            remarks.append(str(error))
    if not manifests:
        said = remarks[0] if remarks else f"{run}: no episodes yet; run `codediffuser demo {run}`"
        raise EpisodeError(said)
    failed, lost = _failures(run)
    return Survey(
        path=run,
        what="run",
        episodes=tuple(found),
        features=_features(manifests[0]),
        cameras=_cameras(manifests[0]),
        bytes_by_part=_sizes(run, folders),
        failed=failed,
        remarks=(*remarks, *lost),
    )


def run_motion(run: Path, *, moments: int = 60, most: int = 64) -> Motion:
    """State and actions of at most `most` evenly spread episodes that have the same columns.

    Raises:
        EpisodeError: An episode is damaged.
    """
    folders = list_episodes(run)
    episodes = [Episode.open(folders[i]) for i in spread(len(folders), most)]
    motion = episodes[0].manifest.motion
    alike = [e for e in episodes if e.manifest.motion == motion]
    return Motion(
        np.stack([resample(e.state, moments) for e in alike]),
        np.stack([resample(e.actions, moments) for e in alike]),
        motion.state_names,
        motion.action_names,
    )


def scene_facts(scene: SceneSpec) -> dict[str, object]:
    """What a scene adds to `EpisodeFacts`."""
    pick, place = scene.object(scene.target.pick), scene.place(scene.target.place)
    return {
        "kind": scene.instruction.kind,
        "split": scene.split,
        "start_m": pick.position_m[:2],
        "target_m": place.position_m[:2],
    }


def _episode(folder: Path, manifest: EpisodeManifest) -> EpisodeFacts:
    scene: Mapping[str, object] = {}
    if SCENE in manifest.files:
        scene = scene_facts(SceneSpec.load(folder / SCENE))
    document = load_document(folder)
    labels = document.labels if document else ()
    return EpisodeFacts(
        id=manifest.id,
        task=manifest.task,
        instruction=manifest.instruction,
        frames=manifest.frames,
        hz=manifest.hz,
        outcome=SUCCESS if manifest.success else manifest.reason or "failed",
        source=manifest.source,
        labels=tuple(
            LabelFacts(e.role, e.category, e.provenance.source, e.num_points) for e in labels
        ),
        code=f"{manifest.versions.get('codediffuser', NOT_RECORDED)} ({manifest.git_commit})",
        **scene,  # type: ignore[arg-type]
    )


def _failures(run: Path) -> tuple[dict[str, int], list[str]]:
    """Scenes without an episode by the phase that failed, and failure files that are damaged."""
    counts, damaged = Counter[str](), []
    for path in sorted((run / EPISODES / FAILURES).glob("*.json")):
        try:
            counts[DemoFailure.load(path).phase] += 1
        except CodeDiffuserError as error:
            damaged.append(str(error))
    return dict(counts), damaged


def _cameras(manifest: EpisodeManifest) -> dict[str, str]:
    cameras = {}
    for c in manifest.cameras:
        gives = ["colour", *["depth"] * c.depth, *["calibrated"] * c.calibrated]
        cameras[c.name] = f"{c.width} x {c.height}, {', '.join([*gives, *['moving'] * c.moving])}"
    return cameras


def _features(manifest: EpisodeManifest) -> tuple[FeatureFacts, ...]:
    motion = manifest.motion
    features = [
        FeatureFacts(name, "float32", (len(names),), ", ".join(names))
        for name, names in (("state", motion.state_names), ("action", motion.action_names))
    ]
    for c in manifest.cameras:
        features.append(FeatureFacts(f"{c.name} colour", "uint8", (c.height, c.width, 3)))
        if c.depth:
            features.append(FeatureFacts(f"{c.name} depth", "uint16", (c.height, c.width), "mm"))
    return tuple(features)


def _sizes(run: Path, folders: list[Path]) -> dict[str, int]:
    sizes = {
        part: sum((folder / name).stat().st_size for folder in folders if (folder / name).is_file())
        for part, name in PARTS.items()
    }
    sizes["scenes and reset pictures"] = bytes_below([run / SCENES])
    others = [p for p in run.iterdir() if p.is_dir() and p.name not in (EPISODES, SCENES)]
    sizes |= {f"{p.name}/": bytes_below([p]) for p in sorted(others)}
    return {part: size for part, size in sizes.items() if size}
