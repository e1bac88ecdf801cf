"""What the built-in network learns: for each pixel its category and the middle of its instance.

The middle is told in the picture: how many pixels away it appears, and how much deeper it lies.
Unlike an offset in metres that looks the same wherever in the picture an instance is seen, which is
what a convolution can learn; intrinsics turn it into a point of the world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.cameras import project
from codediffuser.datagen.task import Task
from codediffuser.labeling.perception.rendered import StartScene, body_center, seen_places
from codediffuser.pointcloud import backproject_depth, inside_box
from codediffuser.poses import apply_transform

CATEGORIES = ("background", "mug", "branch", "battery", "slot", "book")
"""Classes of the network, in the order of its reference vectors."""

VOTE_SCALE = np.array([32.0, 32.0, 0.1], dtype=np.float32)
"""Units of a vote: pixels across, pixels down, metres of depth."""


@dataclass(frozen=True, slots=True)
class Targets:
    """What the pixels of a scene's views show."""

    instance: np.ndarray
    """(V, H, W) uint8: 0 for the background, else 1 + row of the next two."""
    category: np.ndarray
    """(n,) uint8, indices into `CATEGORIES`."""
    center_world: np.ndarray
    """(n, 3) float32, metres."""


def make_targets(task: Task, start: StartScene) -> Targets:
    """Number the instances of a drawn scene and say which pixels show them.

    Objects of the network's categories are told by what was drawn, places by their regions.
    """
    scene, rows = start.scene, dict[int, int]()
    categories: list[int] = []
    centers: list[np.ndarray] = []
    for row, obj in enumerate(scene.objects):
        if obj.category in CATEGORIES:
            T = start.T_world_start.get(obj.id, obj.T_world_object)
            centers.append(apply_transform(T, body_center(task, obj)[None])[0])
            categories.append(CATEGORIES.index(obj.category))
            rows[row] = len(centers)
    places = seen_places(task, scene)
    numbers = np.zeros(start.object_index.shape, dtype=np.uint8)
    for row, number in rows.items():
        numbers[start.object_index == row] = number
    first = len(centers) + 1
    for place in places:
        centers.append(np.array(place.center_m))
        categories.append(CATEGORIES.index(place.category))
    fixed = np.array([*(o.fixed for o in scene.objects), False, True])  # -2 robot, -1 nothing
    free = fixed[start.object_index]
    for view, flat, is_free in zip(
        start.views, numbers.reshape(len(numbers), -1), free.reshape(len(free), -1), strict=True
    ):
        points, pixel = backproject_depth(view.depth_m, view.camera.K, view.camera.T_world_camera)
        for number, place in enumerate(places, start=first):
            center, half = np.array(place.center_m), np.array(place.size_m) / 2
            inside = pixel[inside_box(points, center - half, center + half)]
            flat[inside[is_free[inside]]] = number
    return Targets(
        numbers,
        np.array(categories, dtype=np.uint8),
        np.array(centers, dtype=np.float32).reshape(-1, 3),
    )


def pixel_votes(start: StartScene, targets: Targets) -> np.ndarray:
    """Votes (V, H, W, 3) float32 in units of `VOTE_SCALE`; 0 in the background."""
    return np.stack(
        [
            _votes(view.depth_m, view.camera.K, view.camera.T_world_camera, number, targets)
            for view, number in zip(start.views, targets.instance, strict=True)
        ]
    )


def _votes(
    depth_m: np.ndarray,
    K: np.ndarray,
    T_world_camera: np.ndarray,
    number: np.ndarray,
    targets: Targets,
) -> np.ndarray:
    uv, z = project(targets.center_world, K, T_world_camera)
    centers = np.concatenate([np.zeros((1, 3)), np.column_stack([uv, z])]).astype(np.float32)
    rows, columns = np.indices(depth_m.shape, dtype=np.float32)
    here = np.stack([columns, rows, depth_m], axis=-1)
    votes = (centers[number] - here) / VOTE_SCALE
    votes[(number == 0) | ~(depth_m > 0)] = 0.0
    return np.asarray(votes, dtype=np.float32)


def voted_points(
    votes: np.ndarray, depth_m: np.ndarray, K: np.ndarray, T_world_camera: np.ndarray
) -> np.ndarray:
    """Turn the votes (H, W, 3) of one view into points of the world (H, W, 3) float32, metres."""
    rows, columns = np.indices(depth_m.shape, dtype=np.float32)
    scaled = votes * VOTE_SCALE
    z = depth_m + scaled[..., 2]
    x = (columns + scaled[..., 0] - np.float32(K[0, 2])) / np.float32(K[0, 0]) * z
    y = (rows + scaled[..., 1] - np.float32(K[1, 2])) / np.float32(K[1, 1]) * z
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return np.asarray(apply_transform(T_world_camera, points)).reshape(*depth_m.shape, 3)
