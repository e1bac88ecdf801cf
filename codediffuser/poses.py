"""Rigid transforms, quaternions and the rotation-6D form of actions.

`T_a_b` (4, 4) takes coordinates in frame b to frame a, so inner names touch:
`T_world_mug = T_world_camera @ T_camera_mug`. Quaternions are (w, x, y, z) here, and every name
that holds one says so. Cameras follow OpenCV: x right, y down, z forward.
"""

from __future__ import annotations

import numpy as np

from codediffuser.errors import ShapeError


def quat_wxyz_to_matrix(quat_wxyz: np.ndarray) -> np.ndarray:
    """Turn quaternions (..., 4) of any non-zero length into rotation matrices (..., 3, 3) float64.

    Raises:
        ShapeError: The last axis is not 4, or a quaternion has no length.
    """
    q = np.asarray(quat_wxyz, dtype=np.float64)
    if q.shape[-1:] != (4,):
        raise ShapeError(f"quat_wxyz: expected shape (..., 4), got {q.shape}")
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if np.any(norm < 1e-12):
        raise ShapeError("quat_wxyz: a quaternion of zero length has no rotation")
    w, x, y, z = np.moveaxis(q / norm, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def matrix_to_quat_wxyz(R: np.ndarray) -> np.ndarray:
    """Turn rotation matrices (..., 3, 3) into unit quaternions (..., 4) float64 with w >= 0."""
    R = np.asarray(R, dtype=np.float64)
    if R.shape[-2:] != (3, 3):
        raise ShapeError(f"R: expected shape (..., 3, 3), got {R.shape}")
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    # Four ways to read the quaternion, each scaled by one component; the largest one is
    # well-conditioned.
    candidates = np.stack(
        [
            np.stack(
                [
                    1 + xx + yy + zz,
                    R[..., 2, 1] - R[..., 1, 2],
                    R[..., 0, 2] - R[..., 2, 0],
                    R[..., 1, 0] - R[..., 0, 1],
                ],
                axis=-1,
            ),
            np.stack(
                [
                    R[..., 2, 1] - R[..., 1, 2],
                    1 + xx - yy - zz,
                    R[..., 1, 0] + R[..., 0, 1],
                    R[..., 0, 2] + R[..., 2, 0],
                ],
                axis=-1,
            ),
            np.stack(
                [
                    R[..., 0, 2] - R[..., 2, 0],
                    R[..., 1, 0] + R[..., 0, 1],
                    1 - xx + yy - zz,
                    R[..., 2, 1] + R[..., 1, 2],
                ],
                axis=-1,
            ),
            np.stack(
                [
                    R[..., 1, 0] - R[..., 0, 1],
                    R[..., 0, 2] + R[..., 2, 0],
                    R[..., 2, 1] + R[..., 1, 2],
                    1 - xx - yy + zz,
                ],
                axis=-1,
            ),
        ],
        axis=-2,
    )
    best = np.argmax(np.diagonal(candidates, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def make_transform(R: np.ndarray, t_m: np.ndarray) -> np.ndarray:
    """Join rotations (..., 3, 3) and translations (..., 3) in metres to transforms (..., 4, 4)."""
    R, t_m = np.asarray(R, dtype=np.float64), np.asarray(t_m, dtype=np.float64)
    T = np.zeros((*t_m.shape[:-1], 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t_m
    T[..., 3, 3] = 1.0
    return T


def pose_to_transform(position_m: np.ndarray, quat_wxyz: np.ndarray) -> np.ndarray:
    """Join positions (..., 3) in metres and quaternions (..., 4) to transforms (..., 4, 4)."""
    return make_transform(quat_wxyz_to_matrix(quat_wxyz), position_m)


def invert_transform(T: np.ndarray) -> np.ndarray:
    """Invert rigid transforms (..., 4, 4) exactly, without a general matrix inverse."""
    R_inv = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_transform(R_inv, -(R_inv @ T[..., :3, 3:])[..., 0])


def apply_transform(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Move points (N, 3) by one transform (4, 4); the dtype of the points is kept."""
    moved = points @ T[:3, :3].T.astype(points.dtype) + T[:3, 3].astype(points.dtype)
    return np.asarray(moved, dtype=points.dtype)


def rotation_z(yaw_rad: float) -> np.ndarray:
    """Rotation (3, 3) about the world's z axis, counter-clockwise from above."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def matrix_to_rot6d(R: np.ndarray) -> np.ndarray:
    """First two columns of rotations (..., 3, 3), one after the other, as (..., 6).

    Source: Zhou et al., On the Continuity of Rotation Representations in Neural Networks, 2019.
    """
    R = np.asarray(R)
    return np.concatenate([R[..., :, 0], R[..., :, 1]], axis=-1)


def rot6d_to_matrix(rot6d: np.ndarray) -> np.ndarray:
    """Gram-Schmidt of two columns (..., 6) to rotations (..., 3, 3) float64.

    Raises:
        ShapeError: The last axis is not 6, or the two columns are parallel or zero.
    """
    r = np.asarray(rot6d, dtype=np.float64)
    if r.shape[-1:] != (6,):
        raise ShapeError(f"rot6d: expected shape (..., 6), got {r.shape}")
    a, b = r[..., :3], r[..., 3:]
    a_norm = np.linalg.norm(a, axis=-1, keepdims=True)
    x = a / np.maximum(a_norm, 1e-12)
    b = b - np.sum(x * b, axis=-1, keepdims=True) * x
    b_norm = np.linalg.norm(b, axis=-1, keepdims=True)
    if np.any(a_norm < 1e-9) or np.any(b_norm < 1e-9):
        raise ShapeError("rot6d: its two columns must be non-zero and not parallel")
    y = b / b_norm
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def look_rotation(look: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Rotation R_world_camera (3, 3) with OpenCV axes from a look direction and a right hint.

    Args:
        look: (3,) direction of the optical axis, any length.
        right: (3,) roughly the image's right; made orthogonal to `look`.
    """
    z = np.asarray(look, dtype=np.float64)
    z = z / np.linalg.norm(z)
    x = np.asarray(right, dtype=np.float64)
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)
