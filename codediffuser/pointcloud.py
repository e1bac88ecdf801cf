"""Point clouds in the world frame: back-projection, fusing, cropping, even sampling."""

from __future__ import annotations

from collections.abc import Iterable

import fpsample
import numpy as np

from codediffuser.errors import ShapeError
from codediffuser.poses import apply_transform


def check_points(points: np.ndarray, name: str = "points") -> None:
    """Raise `ShapeError` unless `points` is (N, 3) floating point; N may be 0."""
    if points.ndim != 2 or points.shape[1] != 3 or not np.issubdtype(points.dtype, np.floating):
        raise ShapeError(
            f"{name}: expected shape (N, 3) of floats, got {points.shape} {points.dtype}"
        )


def backproject_depth(
    depth_m: np.ndarray, K: np.ndarray, T_world_camera: np.ndarray, *, max_depth_m: float = 2.0
) -> tuple[np.ndarray, np.ndarray]:
    """Lift a depth image to world points, leaving out pixels with no usable reading.

    Depth runs along the optical axis, not along the pixel ray; pixel centres lie on whole numbers.

    Args:
        depth_m: (H, W) float32, metres. 0 or NaN marks a missing reading.
        K: (3, 3) float64 pinhole intrinsics, pixels.
        T_world_camera: (4, 4) float64 camera pose, OpenCV axes.
        max_depth_m: Farther readings are left out.

    Returns:
        points_world: (N, 3) float32, metres, in row-major pixel order; N may be 0.
        pixel_index: (N,) int64, row-major index of each point's pixel, to look up its colour.

    Raises:
        ShapeError: An input does not have the shape above.

    Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., sec. 6.1.
    """
    if depth_m.ndim != 2:
        raise ShapeError(f"depth_m: expected shape (H, W), got {depth_m.shape}")
    if K.shape != (3, 3) or T_world_camera.shape != (4, 4):
        raise ShapeError(
            f"expected K (3, 3) and T_world_camera (4, 4), got {K.shape} and {T_world_camera.shape}"
        )
    with np.errstate(invalid="ignore"):
        valid = (depth_m > 0) & (depth_m <= max_depth_m)
    v, u = np.nonzero(valid)
    z = depth_m[v, u].astype(np.float32)
    x = (u - K[0, 2]).astype(np.float32) / np.float32(K[0, 0]) * z
    y = (v - K[1, 2]).astype(np.float32) / np.float32(K[1, 1]) * z
    points = apply_transform(T_world_camera, np.stack([x, y, z], axis=-1))
    return points, v.astype(np.int64) * depth_m.shape[1] + u


def fuse_views(
    views: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]], *, max_depth_m: float = 2.0
) -> np.ndarray:
    """Join the back-projections of several views (depth_m, K, T_world_camera) in their order.

    Returns:
        points_world: (N, 3) float32, metres; (0, 3) for no views.
    """
    clouds = [backproject_depth(d, K, T, max_depth_m=max_depth_m)[0] for d, K, T in views]
    return np.concatenate([np.zeros((0, 3), dtype=np.float32), *clouds])


def inside_box(points: np.ndarray, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which points (N, 3) lie in the closed axis-aligned box low..high (3,)."""
    check_points(points)
    inside = np.ones(len(points), dtype=bool)
    # Column by column: a reduction over an axis of three is several times slower.
    for axis in range(3):
        values = points[:, axis]
        inside &= (values >= low_m[axis]) & (values <= high_m[axis])
    return inside


def crop_box(points: np.ndarray, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
    """Return the points (M, 3) that lie in the closed axis-aligned box low..high (3,)."""
    return np.asarray(points[inside_box(points, low_m, high_m)])


def farthest_point_indices(points: np.ndarray, count: int) -> np.ndarray:
    """Choose `count` evenly spread points: indices (min(count, N),) int64.

    Exact farthest point sampling (k-d line buckets of `fpsample`), beginning with point 0, so the
    same cloud gives the same choice. With N <= count every index comes back.
    """
    check_points(points)
    n = len(points)
    if n <= count:
        return np.arange(n, dtype=np.int64)
    if count <= 0:
        return np.zeros(0, dtype=np.int64)
    # Higher buckets pay only on large clouds; the library refuses 2**h > N.
    height = min(7 if n > 20_000 else 5 if n > 2_000 else 3, n.bit_length() - 1)
    chosen = fpsample.bucket_fps_kdline_sampling(
        np.ascontiguousarray(points, dtype=np.float32),
        count,
        h=height,
        start_idx=0,  # left out, the library draws one at random
    )
    return np.asarray(chosen, dtype=np.int64)
