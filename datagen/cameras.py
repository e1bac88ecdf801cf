"""Cameras of a task in OpenCV axes, and the one conversion to the simulator's axes.

OpenCV: x right, y down, z forward. SAPIEN cameras: x forward, y left, z up.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from codediffuser.poses import look_rotation, make_transform, matrix_to_quat_wxyz

if TYPE_CHECKING:
    import sapien

    from codediffuser.datagen.task_config import CameraConfig, CameraView

R_SAPIEN_OPENCV = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Takes OpenCV camera coordinates to SAPIEN camera coordinates."""


def intrinsics(config: CameraConfig) -> np.ndarray:
    """Pinhole matrix K (3, 3) float64 in pixels, square pixels, pixel centres on whole numbers.

    SAPIEN counts from the outer corner of the first pixel, OpenCV from its centre: half a pixel
    apart, which is why the principal point is at (W - 1) / 2.
    """
    focal = config.height / 2 / np.tan(config.fov_y_rad / 2)
    return np.array(
        [
            [focal, 0.0, (config.width - 1) / 2],
            [0.0, focal, (config.height - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )


def T_world_camera(view: CameraView) -> np.ndarray:
    """Pose (4, 4) float64 of a camera, OpenCV axes."""
    R = look_rotation(np.array(view.look), np.array(view.right))
    return make_transform(R, np.array(view.position_m))


def camera_parameters(config: CameraConfig) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name to (K, T_world_camera) for every camera, in the configured order."""
    K = intrinsics(config)
    return {view.name: (K, T_world_camera(view)) for view in config.views}


def project(
    points_world: np.ndarray, K: np.ndarray, T_world_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Project points (N, 3) in metres.

    Returns:
        uv: (N, 2) float64 pixels (column, row); meaningless where depth is not positive.
        depth_m: (N,) float64 along the optical axis.
    """
    R, t = T_world_camera[:3, :3], T_world_camera[:3, 3]
    points_camera = (np.asarray(points_world, dtype=np.float64) - t) @ R
    depth_m = points_camera[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = (points_camera @ K.T)[:, :2] / depth_m[:, None]
    return uv, depth_m


def sapien_camera_pose(T_world_camera: np.ndarray) -> sapien.Pose:
    """Convert an OpenCV camera pose (4, 4) to the simulator's."""
    import sapien

    R = T_world_camera[:3, :3] @ R_SAPIEN_OPENCV.T
    return sapien.Pose(T_world_camera[:3, 3], matrix_to_quat_wxyz(R))
