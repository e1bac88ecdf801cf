"""Labels of simulated demonstrations by features: the instance found at the logged place.

The rule of the paper's supplement, with a bound that it lacks: an instance counts only when its
middle lies near to where the target was logged and no other one does, so what perception missed is
an error and never a label on the neighbour.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser import __version__
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import Task
from codediffuser.errors import LabelError
from codediffuser.labeling.ground_truth import thin_points
from codediffuser.labeling.label import AttentionLabel, Provenance, Role
from codediffuser.labeling.perception.finding import FoundInstance
from codediffuser.labeling.perception.instances import FeaturesSource
from codediffuser.labeling.perception.rendered import body_center
from codediffuser.labeling.perception.views import views_at
from codediffuser.poses import apply_transform

MAX_DISTANCE_M = 0.015
"""From the logged middle of a target to the middle of the instance that is taken for it."""


def logged_labels(
    episode: Episode, task: Task, source: FeaturesSource
) -> tuple[AttentionLabel, AttentionLabel]:
    """Label the target object, which its recorded motion carries, and the target place.

    Raises:
        EpisodeError: A real recording, which has no scene file or states.
        LabelError: No instance was found at a target, or more than one.
    """
    scene, trajectory = episode.scene, episode.trajectory
    pick, place = scene.object(scene.target.pick), scene.place(scene.target.place)
    found = source.found(views_at(episode), task)
    T_world_pick = trajectory.T_world_object(pick.id, 0)
    middle = apply_transform(T_world_pick, body_center(task, pick)[None])[0]

    def label(
        role: Role, category: str, name: str, at_world: np.ndarray, follows: str | None
    ) -> AttentionLabel:
        instance = instance_at(
            found, category, at_world, f"scene {scene.scene_id}, {role} '{name}'"
        )
        provenance = Provenance(
            "features", "labeling.perception.logged", __version__, instance.confidence
        )
        points = thin_points(instance.points_world)
        return AttentionLabel(role, category, name, points, follows, provenance)

    return (
        label("pick", pick.category, pick.id, middle, pick.id),
        label("place", place.category, place.id, np.array(place.center_m), None),
    )


def instance_at(
    found: Sequence[FoundInstance],
    category: str,
    at_world: np.ndarray,
    what: str,
    *,
    max_distance_m: float = MAX_DISTANCE_M,
) -> FoundInstance:
    """The only instance of a category whose middle is near to a place.

    Args:
        found: All that perception found.
        category: Of the target.
        at_world: (3,) where its middle was logged, metres.
        what: Names the target in messages.
        max_distance_m: Farther instances are others.

    Raises:
        LabelError: There is none, or more than one.
    """
    candidates = [f for f in found if f.category == category]
    distances = [float(np.linalg.norm(f.middle_world - at_world)) for f in candidates]
    near = [f for f, d in zip(candidates, distances, strict=True) if d <= max_distance_m]
    if len(near) == 1:
        return near[0]
    nearest = f"the nearest is {min(distances):.3f} m away" if distances else "none was found"
    raise LabelError(
        f"{what}: expected one {category} within {max_distance_m} m of where it was logged, "
        f"{np.round(at_world, 3).tolist()}; found {len(near)} of {len(candidates)}, {nearest}; "
        "label the episode by hand, or from the simulator with --source oracle"
    )
