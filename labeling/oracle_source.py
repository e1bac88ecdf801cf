"""The `oracle` source: instances by the simulator's true shapes, for simulated episodes alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.labeling.auto import start_cloud
from codediffuser.labeling.ground_truth import GroundTruthConfig, object_points, place_points
from codediffuser.labeling.instances import INSTANCE_SOURCES, SelectableInstance


@INSTANCE_SOURCES.add("oracle")
class OracleSource:
    """Objects that wait, and all places, taken ones included.

    The points are those that ground-truth labels are made of, so choosing the true target gives
    the true label. What the cameras show too little of is left out.
    """

    def instances(self, episode: Episode, task: Task) -> tuple[SelectableInstance, ...]:
        """Objects first, then places, each in the order of the scene file.

        Raises:
            EpisodeError: A real recording, which has no scene file or states.
        """
        scene, trajectory = episode.scene, episode.trajectory
        T_start = {name: trajectory.T_world_object(name, 0) for name in trajectory.object_ids}
        cloud = start_cloud(episode, task)
        least = GroundTruthConfig().min_points
        found = _candidates(task, scene, T_start, cloud)
        return tuple(i for i in found if len(i.points_world) >= least)


def _candidates(
    task: Task, scene: SceneSpec, T_start: dict[str, np.ndarray], cloud: np.ndarray
) -> Iterator[SelectableInstance]:
    margin_m = GroundTruthConfig().margin_m
    for thing in scene.pickable:
        points = object_points(task, scene, thing, T_start, cloud, margin_m)
        yield SelectableInstance(
            thing.id, thing.category, thing.name, "pick", points, follows=thing.id
        )  # fmt: skip
    taken_by = {obj.place: obj.name for obj in scene.objects if obj.place is not None}
    for place in scene.places:
        points = place_points(task, scene, place, T_start, cloud, margin_m)
        yield SelectableInstance(
            place.id, place.category, place.category, "place", points,
            taken_by=taken_by.get(place.id, ""),
        )  # fmt: skip
