"""Quality warnings: what looks wrong about a selection before it is submitted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from codediffuser.datagen.episode_format import SCENE, STATES
from codediffuser.errors import CodeDiffuserError
from codediffuser.labeling.ground_truth import GroundTruthConfig
from codediffuser.labeling.gui.draft import Draft
from codediffuser.labeling.gui.episode_scene import EpisodeScene

MOVED_M = 0.03
"""An object that was picked moves farther than that during the episode."""


def warnings(scene: EpisodeScene, draft: Draft) -> list[str]:
    """Say what is doubtful about a selection; none of it forbids to submit it.

    A submit is refused only for missing or surplus targets, which the window shows beside.
    """
    if scene.episode is None:
        return []
    return [*_episode(scene), *_targets(scene, draft), *_words(scene, draft)]


def _episode(scene: EpisodeScene) -> Iterator[str]:
    assert scene.episode is not None
    manifest = scene.episode.manifest
    if not manifest.success:
        yield f"the demonstration failed: {manifest.reason or 'no reason given'}"


def _targets(scene: EpisodeScene, draft: Draft) -> Iterator[str]:
    least = GroundTruthConfig().min_points
    for role, name in draft.selection:
        instance = scene.instance(name)
        if instance is None:
            yield f"{role} target {name} is not among the instances that are shown"
            continue
        if role == "place" and instance.taken_by:
            yield f"place target is taken: {name} holds a {instance.taken_by}"
        if len(instance.points_world) < least:
            yield f"{name} has only {len(instance.points_world)} points"
        if role == "pick" and instance.follows is not None:
            yield from _motion(scene, instance.follows)


def _motion(scene: EpisodeScene, object_id: str) -> Iterator[str]:
    """Compare with what the recording shows to have been moved."""
    assert scene.episode is not None
    if STATES not in scene.episode.manifest.files:
        return
    try:
        trajectory = scene.episode.trajectory
    except CodeDiffuserError:
        return
    start = trajectory.object_position_m[0]
    travel = np.linalg.norm(trajectory.object_position_m - start, axis=-1).max(axis=0)
    moved = dict(zip(trajectory.object_ids, travel, strict=True))
    most = max(moved, key=lambda name: moved[name])
    if moved.get(object_id, 0.0) < MOVED_M <= moved[most]:
        yield f"{object_id} does not move in this demonstration; {most} does"


def _words(scene: EpisodeScene, draft: Draft) -> Iterator[str]:
    """Compare with the pairs that the instruction allows, where the scene file says them."""
    assert scene.episode is not None
    if SCENE not in scene.episode.manifest.files:
        return
    try:
        pairs = scene.episode.scene.instruction.pairs
    except CodeDiffuserError:
        return
    chosen = {role: draft.chosen(role) for role in ("pick", "place")}  # type: ignore[arg-type]
    if any(len(names) != 1 for names in chosen.values()):
        return
    pick, place = chosen["pick"][0], chosen["place"][0]
    if (pick, place) in pairs:
        return
    if pick not in {p for p, _ in pairs}:
        others = sorted({p for p, _ in pairs})
        yield f"instruction fits another object: {', '.join(others)}"
    else:
        others = sorted({q for p, q in pairs if p == pick})
        needs = dict((need.role, need.category) for need in scene.needs)
        yield f"instruction fits another {needs['place']}: {', '.join(others)}"
