"""The `features` source: what an operator can choose from, found in the pictures alone.

It reads pictures, depth and calibration of frame 0 and the task's YAML: no object ids, no poses, no
scene file. What has been put away already is told from what waits by what stands beside it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.datagen.box_row import BoxRow
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import Task
from codediffuser.labeling.instances import INSTANCE_SOURCES, SelectableInstance
from codediffuser.labeling.motion import FOUND
from codediffuser.labeling.perception.builtin import BuiltinFeatures
from codediffuser.labeling.perception.color_names import color_name
from codediffuser.labeling.perception.features import get_features
from codediffuser.labeling.perception.finding import FoundInstance, find_instances
from codediffuser.labeling.perception.references import ReferenceLibrary
from codediffuser.labeling.perception.views import View, views_at

BESIDE_M = 0.015
"""An object this near to a place, or to another object that is put away, is put away too."""
IN_PLACE = 0.5
"""An object takes a place when more than this share of its points stands within the place."""


@dataclass(frozen=True, slots=True)
class Arrangement:
    """Which objects wait, and which places are taken by which object."""

    waiting: tuple[int, ...]
    """Indices into the objects."""
    taken_by: dict[int, int]
    """Index of a place to the index of the object that stands there."""


@INSTANCE_SOURCES.add("features")
class FeaturesSource:
    """Instances by the builtin features; see the module. Real recordings do too.

    Args:
        backend: The network; None loads the one that ships when it is first needed.
    """

    def __init__(self, backend: BuiltinFeatures | None = None) -> None:
        self._given = backend

    @functools.cached_property
    def _backend(self) -> BuiltinFeatures:
        found = self._given or get_features("builtin")
        assert isinstance(found, BuiltinFeatures)
        return found

    @functools.cached_property
    def _library(self) -> ReferenceLibrary:
        return self._backend.library()

    def instances(self, episode: Episode, task: Task) -> tuple[SelectableInstance, ...]:
        """Objects that wait, then places, each in lexicographic order of where they are.

        Raises:
            EpisodeError: No calibrated camera gives depth.
            SetupError: The network's weights are missing.
        """
        return self.from_views(views_at(episode), task)

    def from_views(self, views: Sequence[View], task: Task) -> tuple[SelectableInstance, ...]:
        """The same for views that come from elsewhere."""
        return selectable(self.found(views, task), task)

    def found(self, views: Sequence[View], task: Task) -> tuple[FoundInstance, ...]:
        """Everything of the task's categories, what is put away included."""
        return find_instances(views, task, self._backend, self._library)


def looking_for(category: str, task: Task) -> Callable[[Sequence[View]], list[FoundInstance]]:
    """What a tracker asks for the instances of a category in one frame."""
    source = shared_source()
    return lambda views: [f for f in source.found(views, task) if f.category == category]


@functools.cache
def shared_source() -> FeaturesSource:
    """The process's own, with the shipped network."""
    return FeaturesSource()


def selectable(found: Sequence[FoundInstance], task: Task) -> tuple[SelectableInstance, ...]:
    """Turn what was found into what can be chosen: objects that wait, and all places."""
    objects = [f for f in found if f.category == task.pick_category]
    places = [f for f in found if f.category == task.place_category]
    arranged = arrange(objects, places, task.row)
    names = [f"{color_name(o.rgb)} {o.category}" for o in objects]
    chosen = []
    for index in arranged.waiting:
        thing, name = objects[index], f"{FOUND}{objects[index].category}_{index}"
        chosen.append(
            SelectableInstance(
                name, thing.category, names[index], "pick", thing.points_world, follows=name,
                confidence=thing.confidence,
            )
        )  # fmt: skip
    for index, place in enumerate(places):
        taker = arranged.taken_by.get(index)
        chosen.append(
            SelectableInstance(
                f"{FOUND}{place.category}_{index:02d}", place.category, place.category, "place",
                place.points_world, taken_by="" if taker is None else names[taker],
                confidence=place.confidence,
            )
        )  # fmt: skip
    return tuple(chosen)


def arrange(
    objects: Sequence[FoundInstance], places: Sequence[FoundInstance], row: BoxRow | None = None
) -> Arrangement:
    """Tell objects that wait from those that are put away, and places that are taken.

    What stands in the task's row is put away, and its gaps are free. Where there is no row,
    nearness tells: what stands beside a place, or beside an object that does, is put away.
    """
    if row is not None:
        waiting = (i for i, o in enumerate(objects) if not row.holds(o.points_world))
        return Arrangement(tuple(waiting), {})
    reached = cKDTree(np.concatenate([np.zeros((0, 3)), *(p.points_world for p in places)]))
    away: set[int] = set()
    left = set(range(len(objects)))
    while new := {i for i in left if _gap(objects[i], reached) <= BESIDE_M}:
        away |= new
        left -= new
        reached = cKDTree(np.concatenate([objects[i].points_world for i in new]))
    taken_by = {}
    for index, place in enumerate(places):
        low, high = place.points_world.min(axis=0)[:2], place.points_world.max(axis=0)[:2]
        for i in sorted(away):
            at = objects[i].points_world[:, :2]
            if np.mean(((at >= low) & (at <= high)).all(axis=1)) > IN_PLACE:
                taken_by[index] = i
    return Arrangement(tuple(sorted(left)), taken_by)


def _gap(thing: FoundInstance, others: cKDTree) -> float:
    """Smallest distance from a point of the thing to any of the others, metres."""
    distance, _ = others.query(thing.points_world, distance_upper_bound=2 * BESIDE_M)
    return float(distance.min())
