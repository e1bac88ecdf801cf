"""Rows of state and of actions: poses from numbers, openings, and which joints the log keeps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from codediffuser.datagen.episode_format import MotionRecord
from codediffuser.datasets.importing.config import ImportConfig, PoseLayout
from codediffuser.errors import DatasetError
from codediffuser.poses import (
    make_transform,
    matrix_to_rot6d,
    pose_to_transform,
    rot6d_to_matrix,
)

FINGER = "gripper_finger"
"""Joint that is added to the log when the gripper is none of the recorded joints."""

LAYOUT_SIZES: dict[PoseLayout, int] = {
    "xyz_quat_wxyz": 7, "xyz_quat_xyzw": 7, "xyz_rotvec": 6, "xyz_rot6d": 9,
}  # fmt: skip


def pose_from_columns(row: np.ndarray, layout: PoseLayout, where: str) -> np.ndarray:
    """Pose (4, 4) float64 from bare numbers.

    Raises:
        DatasetError: There are more or fewer numbers than the layout has.
    """
    row = np.asarray(row, np.float64)
    if row.shape != (LAYOUT_SIZES[layout],):
        raise DatasetError(
            f"{where}: layout {layout} needs {LAYOUT_SIZES[layout]} numbers, got {row.shape}; set "
            "columns or layout"
        )
    if layout == "xyz_rotvec":
        return make_transform(Rotation.from_rotvec(row[3:]).as_matrix(), row[:3])
    if layout == "xyz_rot6d":
        return make_transform(rot6d_to_matrix(row[3:]), row[:3])
    quat = row[3:] if layout == "xyz_quat_wxyz" else row[[6, 3, 4, 5]]
    if not np.linalg.norm(quat) > 1e-6:
        raise DatasetError(f"{where}: a pose has a quaternion of zeros")
    return pose_to_transform(row[:3], quat / np.linalg.norm(quat))


def hand_row(T_world_hand: np.ndarray, opening_m: float) -> np.ndarray:
    """A row (10,) float32 of state or actions, see `trajectory.ACTION_NAMES`."""
    rot6d = matrix_to_rot6d(T_world_hand[:3, :3])
    return np.concatenate([T_world_hand[:3, 3], rot6d, [opening_m]]).astype(np.float32)


def opening_of(values: np.ndarray, scale: float) -> float:
    """Finger opening in metres: the mean of the absolute values."""
    return float(np.abs(values).mean() * scale)


def mix_poses(T0: np.ndarray, T1: np.ndarray, weight: float) -> np.ndarray:
    """Pose between two: positions in a straight line, rotations along the shortest arc."""
    rotations = Rotation.from_matrix(np.stack([T0[:3, :3], T1[:3, :3]]))
    R = Slerp([0.0, 1.0], rotations)(weight).as_matrix()
    return make_transform(R, (1 - weight) * T0[:3, 3] + weight * T1[:3, 3])


def hand_motion(config: ImportConfig, joint_names: Sequence[str]) -> MotionRecord:
    """The motion record of a hand state.

    Args:
        config: The configuration.
        joint_names: The joints as the log names them.
    """
    gripper = gripper_in_joints(config)
    if gripper and set(gripper) <= set(joint_names):
        return MotionRecord(gripper_joints=gripper)
    return MotionRecord(gripper_joints=(FINGER,))


def gripper_in_joints(config: ImportConfig) -> tuple[str, ...]:
    """Recorded joints that are the fingers, in metres; empty when the opening comes from elsewhere.

    Then the log needs no further joint, and what was recorded stays as it was.
    """
    gripper, joints = config.state.gripper, config.state.joints
    if gripper is None or joints is None or gripper.topic != joints.topic:
        return ()
    if gripper.scale != 1.0 or gripper.columns is not None:
        return ()
    if joints.joints and not set(gripper.joints) <= set(joints.joints):
        return ()
    return gripper.joints
