"""Labels from the simulator: the target's points are those that its true shape contains.

Task-independent: an object is the convex parts that collide, at its pose at frame 0; a place is the
region of its `PlaceSpec`, without what can move. Nothing is matched by nearness alone, so a target
that no camera sees is an error and never the wrong cluster.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import trimesh

from codediffuser import __version__
from codediffuser.datagen.known_shapes import Shapes
from codediffuser.datagen.scene import ObjectSpec, PlaceSpec, SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.errors import LabelError
from codediffuser.labeling.label import AttentionLabel, Provenance, Role
from codediffuser.pointcloud import check_points, farthest_point_indices, inside_box
from codediffuser.poses import apply_transform, invert_transform

PROVENANCE = Provenance(
    source="simulator", labeler="labeling.ground_truth", tool_version=__version__
)


_SHAPES: WeakKeyDictionary[Task, Shapes] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class GroundTruthConfig:
    """Tolerances of ground-truth labels."""

    margin_m: float = 0.003
    """Readings this far outside a shape still belong to it: depth comes in whole millimetres."""
    min_points: int = 20
    """Fewer points of a target are an error."""
    max_points: int = 1024
    """More are thinned evenly."""


def ground_truth_labels(
    task: Task,
    scene: SceneSpec,
    T_world_start: Mapping[str, np.ndarray],
    points_world: np.ndarray,
    config: GroundTruthConfig | None = None,
) -> tuple[AttentionLabel, AttentionLabel]:
    """Label the target object, which its motion carries, and the target place, which stands still.

    Args:
        task: Gives the shapes of the scene's objects.
        scene: Names the targets.
        T_world_start: Poses (4, 4) at frame 0 of objects that can move; an object without one is
            where the scene file puts it.
        points_world: (N, 3) float32, metres: the fused cloud of frame 0 in the workspace.
        config: Tolerances; None for the defaults.

    Returns:
        The `pick` and the `place` label.

    Raises:
        LabelError: The cloud shows too little of a target.
    """
    check_points(points_world, "points_world")
    config = config or GroundTruthConfig()
    pick, place = scene.object(scene.target.pick), scene.place(scene.target.place)
    points = {
        "pick": object_points(task, scene, pick, T_world_start, points_world, config.margin_m),
        "place": place_points(task, scene, place, T_world_start, points_world, config.margin_m),
    }

    def label(role: Role, category: str, instance_id: str, follows: str | None) -> AttentionLabel:
        found = points[role]
        if len(found) < config.min_points:
            raise LabelError(
                f"scene {scene.scene_id}: expected at least {config.min_points} points of "
                f"{category} '{instance_id}' in the cloud of frame 0, got {len(found)}; it is "
                "hidden from the cameras or outside the workspace: add a camera or resolution"
            )
        points_kept = thin_points(found, config)
        return AttentionLabel(role, category, instance_id, points_kept, follows, PROVENANCE)

    return (
        label("pick", pick.category, pick.id, pick.id),
        label("place", place.category, place.id, None),
    )


def thin_points(points_world: np.ndarray, config: GroundTruthConfig | None = None) -> np.ndarray:
    """Choose at most `config.max_points` of a target's points (N, 3), evenly, in their order."""
    limit = (config or GroundTruthConfig()).max_points
    return np.asarray(points_world[np.sort(farthest_point_indices(points_world, limit))])


def signed_distance_m(points: np.ndarray, parts: Sequence[trimesh.Trimesh]) -> np.ndarray:
    """Distance of points (N, 3) to a body of convex parts, negative inside; (N,) float64.

    Outside a part it is the distance to the farthest of its violated planes: exact beside a face,
    too small beside an edge, by at most the factor of the edge's angle.
    """
    best = np.full(len(points), np.inf)
    for part in parts:
        normals, origins = part.face_normals, part.triangles[:, 0]
        offsets = np.einsum("ij,ij->i", normals, origins)
        best = np.minimum(best, (points @ normals.T - offsets).max(axis=1))
    return best


def object_points(
    task: Task,
    scene: SceneSpec,
    target: ObjectSpec,
    T_world_start: Mapping[str, np.ndarray],
    points_world: np.ndarray,
    margin_m: float,
) -> np.ndarray:
    """Points (M, 3) that belong to the target and to no other object more than to it."""
    mine = object_members(task, scene, target, T_world_start, points_world, margin_m)
    return np.asarray(points_world[mine])


def object_members(
    task: Task,
    scene: SceneSpec,
    target: ObjectSpec,
    T_world_now: Mapping[str, np.ndarray],
    points_world: np.ndarray,
    margin_m: float,
) -> np.ndarray:
    """Which points (N, 3) belong to the target and to no other object more than to it, (N,) bool.

    `T_world_now` are the poses at the moment of the points; one that is missing is the scene's.
    """
    members = np.zeros(len(points_world), dtype=bool)
    parts = _shapes(task).of(target).collision
    if not parts:
        return members
    low, high = _bounds_world(parts, _pose(target, T_world_now))
    near_index = np.flatnonzero(inside_box(points_world, low - margin_m, high + margin_m))
    near = points_world[near_index]
    own = _distance(task, target, T_world_now, near)
    keep = own <= margin_m
    for other in scene.objects:
        if other.id != target.id and keep.any():
            keep &= own <= _distance(task, other, T_world_now, near)
    members[near_index[keep]] = True
    return members


def place_points(
    task: Task,
    scene: SceneSpec,
    place: PlaceSpec,
    T_world_start: Mapping[str, np.ndarray],
    points_world: np.ndarray,
    margin_m: float,
) -> np.ndarray:
    """Points (M, 3) in the region of the place that belong to nothing that can move."""
    mine = place_members(task, scene, place, T_world_start, points_world, margin_m)
    return np.asarray(points_world[mine])


def place_members(
    task: Task,
    scene: SceneSpec,
    place: PlaceSpec,
    T_world_now: Mapping[str, np.ndarray],
    points_world: np.ndarray,
    margin_m: float,
) -> np.ndarray:
    """Which points (N, 3) lie in the place and belong to nothing that can move, (N,) bool."""
    center, half = np.array(place.center_m), np.array(place.size_m) / 2
    members = inside_box(points_world, center - half, center + half)
    inside_index = np.flatnonzero(members)
    for obj in scene.objects:
        if not obj.fixed:
            distance = _distance(task, obj, T_world_now, points_world[inside_index])
            members[inside_index] &= distance > margin_m
    return members


def _shapes(task: Task) -> Shapes:
    """The task's bodies, kept as long as the task itself."""
    return _SHAPES.setdefault(task, Shapes(task))


def _distance(
    task: Task, obj: ObjectSpec, T_world_start: Mapping[str, np.ndarray], points_world: np.ndarray
) -> np.ndarray:
    T_object_world = invert_transform(_pose(obj, T_world_start))
    return signed_distance_m(
        apply_transform(T_object_world, points_world.astype(np.float64)),
        _shapes(task).of(obj).collision,
    )


def _pose(obj: ObjectSpec, T_world_start: Mapping[str, np.ndarray]) -> np.ndarray:
    return T_world_start.get(obj.id, obj.T_world_object)


def _bounds_world(
    parts: Sequence[trimesh.Trimesh], T_world_object: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    corners = apply_transform(T_world_object, np.concatenate([p.vertices for p in parts]))
    return corners.min(axis=0), corners.max(axis=0)
