"""Instances from a scene file: the simulator's own knowledge in the place of perception."""

from __future__ import annotations

from collections.abc import Mapping
from weakref import WeakKeyDictionary

import numpy as np

from codediffuser.datagen.scene import ObjectSpec, PlaceSpec, SceneSpec
from codediffuser.datagen.task import Task, get_task
from codediffuser.labeling.language.instances import Directions, Instance, ListedInstances
from codediffuser.labeling.language.vocabulary import Vocabulary
from codediffuser.poses import apply_transform


def simulated_provider(
    scene: SceneSpec,
    points: Mapping[str, np.ndarray] | None = None,
    *,
    task: Task | None = None,
) -> ListedInstances:
    """Offer a scene's objects and free places to programs.

    Objects of a category come waiting ones first, then those that take a place: perception sees
    both. Places come only while free, since a taken one shows no hollow.

    Args:
        scene: The scene as it was reset; ids are those of its objects and places.
        points: Id to points (N, 3) float32, metres, world: what cameras or the mesh show of each.
            For what is missing, or has no point, the body's vertices and the place's corners
            stand in, whose mean is the true middle.
        task: The scene's task; None takes the one that ships.
    """
    task = task or get_task(scene.task)
    seen = {name: cloud for name, cloud in (points or {}).items() if len(cloud)}
    waiting = {thing.id for thing in scene.pickable}
    objects = sorted(scene.objects, key=lambda thing: thing.id not in waiting)
    found = [
        Instance(
            o.id,
            o.category,
            o.name,
            seen[o.id] if o.id in seen else _object_points(task, o),
            label=o.label,
        )
        for o in objects
    ]
    found += [
        Instance(p.id, p.category, p.category, seen.get(p.id, _place_corners(p)))
        for p in scene.free_places
    ]
    observer = task.config.observer
    fixed = [o.category for o in objects if o.fixed]
    return ListedInstances(
        found,
        {"pick": task.pick_category, "place": task.place_category},
        categories=(task.pick_category, task.place_category, *fixed),
        directions=Directions(observer.right, observer.front),
        vocabulary=Vocabulary.of(task),
    )


_VERTICES: WeakKeyDictionary[Task, dict[tuple[object, ...], np.ndarray]] = WeakKeyDictionary()
"""Mesh vertices by task, then by kind and size: building a mesh takes longer than grounding."""


def _object_points(task: Task, thing: ObjectSpec) -> np.ndarray:
    """Vertices (N, 3) float32, metres, world, at reset."""
    known = _VERTICES.setdefault(task, {})
    key = (thing.category, *sorted(thing.shape.items()))
    if key not in known:
        mesh = task.geometry(thing).visual
        known[key] = np.asarray(mesh.vertices, dtype=np.float64)
    return apply_transform(thing.T_world_object, known[key]).astype(np.float32)


def _place_corners(place: PlaceSpec) -> np.ndarray:
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    return (np.array(place.center_m) + signs * np.array(place.size_m) / 2).astype(np.float32)
