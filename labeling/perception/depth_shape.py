"""What the shape of a depth image tells: where surfaces end, and where they face.

Only neighbouring pixels are compared, so both cost a few passes over the image.
"""

from __future__ import annotations

import numpy as np

EDGE_SLOPE = 6.0
"""A surface steeper than this, as depth gained per width of a pixel, counts as a jump. 6 is a
surface that is seen at less than 10 degrees."""


def flying_pixels(
    depth_m: np.ndarray, K: np.ndarray, *, edge_slope: float = EDGE_SLOPE
) -> np.ndarray:
    """Find readings that hang in the air between a near surface and one behind it.

    Depth cameras mix both at a border. Such a reading jumps to a nearer one on one side and to a
    farther one on the other. A clean border jumps on one side alone, a thin thing to the same side
    on both: neither is touched, and so the walls of a crate stay.

    Args:
        depth_m: (H, W) float32, metres; 0 or NaN for no reading, which counts as no neighbour.
        K: (3, 3) intrinsics, pixels; says how wide a pixel is at a distance.
        edge_slope: What makes a jump.

    Returns:
        flying: (H, W) bool.
    """
    flying = np.zeros(depth_m.shape, dtype=bool)
    with np.errstate(invalid="ignore"):
        limit_m = np.where(depth_m > 0, depth_m, np.inf) * np.float32(edge_slope / K[0, 0])
        for image, limit, out in ((depth_m, limit_m, flying), (depth_m.T, limit_m.T, flying.T)):
            step = image[:, 1:] - image[:, :-1]
            step[(image[:, 1:] <= 0) | (image[:, :-1] <= 0)] = 0
            before, after, limit = step[:, :-1], step[:, 1:], limit[:, 1:-1]
            out[:, 1:-1] |= ((before > limit) & (after > limit)) | (
                (before < -limit) & (after < -limit)
            )
    return flying


def normals_camera(
    depth_m: np.ndarray, K: np.ndarray, *, edge_slope: float = EDGE_SLOPE
) -> np.ndarray:
    """Compute the direction that each reading's surface faces.

    Args:
        depth_m: (H, W) float32, metres; 0 or NaN for no reading.
        K: (3, 3) intrinsics, pixels.
        edge_slope: No normal where a neighbour lies beyond such a jump.

    Returns:
        normals: (H, W, 3) float32 of length 1 in camera axes, towards the camera; zeros at the
        border of the image, beside jumps and beside missing readings.
    """
    H, W = depth_m.shape
    normals = np.zeros((H, W, 3), dtype=np.float32)
    if H < 3 or W < 3:
        return normals
    z = np.where(depth_m > 0, depth_m, np.nan)
    v, u = np.indices((H, W), dtype=np.float32)
    x, y = (
        (u - np.float32(K[0, 2])) / np.float32(K[0, 0]),
        (v - np.float32(K[1, 2])) / np.float32(K[1, 1]),
    )
    points = np.stack([x * z, y * z, z], axis=-1)
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    inner = np.cross(down, across)  # down x across looks back along the optical axis
    length = np.linalg.norm(inner, axis=-1)
    limit_m = 2 * edge_slope / K[0, 0] * z[1:-1, 1:-1]
    with np.errstate(invalid="ignore"):
        smooth = (np.abs(across[..., 2]) < limit_m) & (np.abs(down[..., 2]) < limit_m)
        smooth &= length > 0
    normals[1:-1, 1:-1][smooth] = inner[smooth] / length[smooth][:, None]
    return normals
