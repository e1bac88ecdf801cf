"""Attention on a camera's picture: labelled points projected, tested for occlusion, and widened.

Policies that see pictures and no cloud take attention as a mask. The labelled points are sparse on
the picture, so what they hit is dilated to one coherent region.
"""

from __future__ import annotations

import functools

import numpy as np

from codediffuser.datagen.cameras import project
from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import ShapeError
from codediffuser.labeling.label import ROLES
from codediffuser.pointcloud import check_points

DILATION_PX = 3
"""Radius of the disc that every visible point covers, at 160 to 320 pixels of picture width."""
TOLERANCE_M = 0.015
"""A reading nearer to the camera than a point by more than this hides the point."""


def attention_mask(
    points_world: np.ndarray,
    camera: Camera,
    depth_m: np.ndarray | None = None,
    *,
    dilation_px: int = DILATION_PX,
    tolerance_m: float = TOLERANCE_M,
) -> np.ndarray:
    """Where attended points appear on one picture.

    Points behind the camera or beside the picture are dropped, never moved to its edge.

    Args:
        points_world: (N, 3) float, metres; N may be 0.
        camera: Intrinsics and pose; says the size of the picture.
        depth_m: (H, W) float32 depth of the same camera at the same time, along the optical axis,
            0 for no reading. None leaves the test for occlusion out; a missing reading hides
            nothing.
        dilation_px: Radius of the disc around each visible point; 0 marks single pixels.
        tolerance_m: How much nearer than a point a reading may be without hiding it.

    Returns:
        mask: (H, W) bool.

    Raises:
        ShapeError: The points or the depth do not have the shape above.
    """
    row, column, _ = _visible(points_world, camera, depth_m, tolerance_m)
    mask = np.zeros((camera.height, camera.width), dtype=np.uint8)
    _mark(mask, row, column, dilation_px)
    return mask.view(bool)


def role_masks(
    points_world: np.ndarray,
    attention: np.ndarray,
    camera: Camera,
    depth_m: np.ndarray | None = None,
    *,
    dilation_px: int = DILATION_PX,
    tolerance_m: float = TOLERANCE_M,
) -> np.ndarray:
    """One mask per role of an episode's attention at one moment, for one camera.

    Args:
        points_world: (M, 3) float, metres: labelled points where they are at that moment, see
            `AttentionField.carried`.
        attention: (M, 2) float, one channel per role.
        camera: Whose picture.
        depth_m: See `attention_mask`.
        dilation_px: See `attention_mask`.
        tolerance_m: See `attention_mask`.

    Returns:
        masks: (2, H, W) bool in the order of `ROLES`.

    Raises:
        ShapeError: The depth does not fit the camera.
    """
    row, column, seen = _visible(points_world, camera, depth_m, tolerance_m)
    masks = np.zeros((len(ROLES), camera.height, camera.width), dtype=np.uint8)
    for mask, attended in zip(masks, attention[seen].T > 0, strict=True):
        _mark(mask, row[attended], column[attended], dilation_px)
    return masks.view(bool)


def _visible(
    points_world: np.ndarray, camera: Camera, depth_m: np.ndarray | None, tolerance_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row and column of every visible point, and which of the points those are."""
    check_points(points_world, "points_world")
    shape = (camera.height, camera.width)
    if depth_m is not None and depth_m.shape != shape:
        raise ShapeError(f"depth_m: expected {shape} as the camera says, got {depth_m.shape}")
    uv, z = project(points_world, camera.K, camera.T_world_camera)
    # Rounding first would pull points from up to half a pixel outside; far ones overflow integers.
    u, v = uv.T
    with np.errstate(invalid="ignore"):
        inside = (z > 0) & (u >= -0.5) & (u < shape[1] - 0.5) & (v >= -0.5) & (v < shape[0] - 0.5)
    seen = np.flatnonzero(inside)
    column, row = np.floor(uv[seen] + 0.5).astype(np.intp).T
    if depth_m is None:
        return row, column, seen
    reading = depth_m[row, column]
    visible = (reading <= 0) | (reading >= z[seen] - tolerance_m)
    return row[visible], column[visible], seen[visible]


def _mark(mask: np.ndarray, row: np.ndarray, column: np.ndarray, dilation_px: int) -> None:
    """Set a mask (H, W) uint8 of zeros to 1 within a disc around each of these pixels."""
    mask[row, column] = 1
    if dilation_px <= 0 or not len(row):
        return
    import cv2

    # Only where something is marked: a label is small on a picture.
    rows = slice(max(int(row.min()) - dilation_px, 0), int(row.max()) + dilation_px + 1)
    columns = slice(max(int(column.min()) - dilation_px, 0), int(column.max()) + dilation_px + 1)
    mask[rows, columns] = cv2.dilate(mask[rows, columns], _disc(dilation_px))


@functools.cache
def _disc(radius_px: int) -> np.ndarray:
    offset = np.arange(-radius_px, radius_px + 1)
    return (offset[:, None] ** 2 + offset**2 <= radius_px**2).astype(np.uint8)
