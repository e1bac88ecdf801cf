"""How far two sets of labels agree: the same instance, and how near their points lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.errors import ShapeError
from codediffuser.labeling.attention import RADIUS_M
from codediffuser.pointcloud import check_points


@dataclass(frozen=True, slots=True)
class Agreement:
    """Two labelers' word on one target."""

    same_instance: bool
    chamfer_m: float
    iou: float


def chamfer_m(first: np.ndarray, second: np.ndarray) -> float:
    """Symmetric Chamfer distance of two clouds (N, 3) and (M, 3) in metres, not squared.

    The mean distance of a point to the nearest point of the other cloud, taken each way, and the
    mean of the two. 0 for equal clouds.

    Raises:
        ShapeError: A cloud is empty or not (N, 3).
    """
    there, back = _nearest(first, second)
    return float((there.mean() + back.mean()) / 2)


def point_iou(first: np.ndarray, second: np.ndarray, *, radius_m: float = RADIUS_M) -> float:
    """Intersection over union of two clouds (N, 3) and (M, 3), in [0, 1].

    Points that have a point of the other cloud within `radius_m` are shared; each cloud counts
    them on its own, and the intersection is the mean of both counts. Independent of any grid.

    Raises:
        ShapeError: A cloud is empty or not (N, 3).
    """
    there, back = _nearest(first, second)
    shared = (np.count_nonzero(there <= radius_m) + np.count_nonzero(back <= radius_m)) / 2
    return float(shared / (len(first) + len(second) - shared))


def agreement(
    first_id: str, first: np.ndarray, second_id: str, second: np.ndarray
) -> Agreement:  # fmt: skip
    """Compare two labels of one target: instance ids and points (N, 3), (M, 3)."""
    return Agreement(first_id == second_id, chamfer_m(first, second), point_iou(first, second))


def _nearest(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    for name, points in (("first", first), ("second", second)):
        check_points(points, f"{name} cloud")
        if len(points) == 0:
            raise ShapeError(f"{name} cloud: expected at least one point, got none")
    there, _ = cKDTree(second).query(first)
    back, _ = cKDTree(first).query(second)
    return np.asarray(there), np.asarray(back)
