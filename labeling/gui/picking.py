"""Which instance a click means: the one with the point nearest to it in the view.

A view is a plane: the table seen from above (metres), or a camera's picture (pixels). Every reading
of an instance is a point of that plane, so long and hollow things are hit where they are, not where
their middle is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from codediffuser.datagen.episode_format import Camera
from codediffuser.labeling.instances import SelectableInstance
from codediffuser.pointcloud import backproject_depth

TOP_REACH_M = 0.04
"""Clicks farther than this from every instance select nothing."""

CAMERA_REACH_SHARE = 0.10
"""The same in a picture, as a share of its height."""

SAME_READING_M = 0.002
"""A pixel belongs to an instance that has a point this near to the pixel's own."""


@dataclass(frozen=True, slots=True)
class Picker:
    """Instances as points of a plane."""

    points: np.ndarray
    """(N, 2) float64: metres on the table, or pixels (column, row)."""
    owner: np.ndarray
    """(N,) int64: which instance each point belongs to."""
    instances: tuple[SelectableInstance, ...]
    reach: float
    tree: cKDTree | None
    """Of `points`; None when there are none."""

    def nearest(self, at: np.ndarray) -> SelectableInstance | None:
        """The instance with the point nearest to a place (2,); None when none is within reach."""
        if self.tree is None:
            return None
        distance, index = self.tree.query(at, distance_upper_bound=self.reach)
        return self.instances[self.owner[index]] if np.isfinite(distance) else None

    def inside(self, low: np.ndarray, high: np.ndarray) -> list[SelectableInstance]:
        """Instances whose middle lies in the box low..high (2,), in their order."""
        return [
            instance
            for instance, middle in zip(self.instances, self.middles(), strict=True)
            if middle is not None and bool(np.all((middle >= low) & (middle <= high)))
        ]

    def middles(self) -> list[np.ndarray | None]:
        """Mean (2,) of each instance's points; None for one that the view does not show."""
        shown = [self.points[self.owner == k] for k in range(len(self.instances))]
        return [points.mean(axis=0) if len(points) else None for points in shown]

    def territories(self, cell: float, margin: float) -> list[np.ndarray]:
        """Convex hulls of where each instance is nearest and within `margin`.

        They light up under the mouse. What a click means is `nearest`, not the hull.

        Args:
            cell: How finely the plane is looked at, in its units.
            margin: How far a territory reaches beyond the instance's points.

        Returns:
            One (M, 2) float64 polygon per instance, counter-clockwise in the plane's axes; M is 0
            for an instance that the view does not show.
        """
        if self.tree is None:
            return [np.zeros((0, 2)) for _ in self.instances]
        low = self.points.min(axis=0) - margin
        width, height = np.ceil((np.ptp(self.points, axis=0) + 2 * margin) / cell).astype(int)
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        centers = low + (np.stack([columns, rows], axis=-1) + 0.5) * cell
        _, index = self.tree.query(centers, distance_upper_bound=margin)
        near = np.append(self.owner, -1)[index]
        return [_hull(centers[near == k]) for k in range(len(self.instances))]


def top_picker(instances: Sequence[SelectableInstance]) -> Picker:
    """Instances seen from straight above; the plane is world x and y in metres."""
    points = [i.points_world[:, :2].astype(np.float64) for i in instances]
    owner = [np.full(len(p), k) for k, p in enumerate(points)]
    return _picker(points, owner, tuple(instances), TOP_REACH_M)


def camera_picker(
    instances: Sequence[SelectableInstance], depth_m: np.ndarray, camera: Camera
) -> Picker:
    """Instances in one camera's picture; the plane is that of its pixels (column, row).

    What something else hides is not there: a pixel belongs to the instance whose reading it is.

    Args:
        instances: Instances at the moment of the picture.
        depth_m: (H, W) float32, metres.
        camera: Where it was taken.
    """
    reach = CAMERA_REACH_SHARE * camera.height
    if not instances:
        return _picker([], [], (), reach)
    seen, pixel = backproject_depth(depth_m, camera.K, camera.T_world_camera)
    cloud = np.concatenate([i.points_world for i in instances])
    whose = np.repeat(np.arange(len(instances)), [len(i.points_world) for i in instances])
    low, high = cloud.min(axis=0) - SAME_READING_M, cloud.max(axis=0) + SAME_READING_M
    near = np.flatnonzero(((seen >= low) & (seen <= high)).all(axis=1))
    distance, index = cKDTree(cloud).query(seen[near], distance_upper_bound=SAME_READING_M)
    hit = np.isfinite(distance)
    rows, columns = np.divmod(pixel[near[hit]], camera.width)
    points = np.stack([columns, rows], axis=-1).astype(np.float64)
    return _picker([points], [whose[index[hit]]], tuple(instances), reach)


def _picker(
    points: list[np.ndarray],
    owner: list[np.ndarray],
    instances: tuple[SelectableInstance, ...],
    reach: float,
) -> Picker:
    joined = np.concatenate([np.zeros((0, 2)), *points])
    owners = np.concatenate([np.zeros(0, np.int64), *owner]).astype(np.int64)
    tree = cKDTree(joined) if len(joined) else None
    return Picker(joined, owners, instances, reach, tree)


def _hull(points: np.ndarray) -> np.ndarray:
    """Corners (M, 2) of the convex hull of points (N, 2), counter-clockwise; M is 0 for none."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        # Fewer than three points, or all in a row.
        return np.zeros((0, 2))
