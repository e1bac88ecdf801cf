"""What messages of many types say: poses, transforms, joints, numbers, text, calibration.

Types are told by their fields, so that ROS 1, ROS 2 and Foxglove messages, and a lab's own that
are made like them, are all read here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from codediffuser.errors import DatasetError
from codediffuser.poses import pose_to_transform

REQUEST_RECEIVED = 1
"""`service_msgs/ServiceEventInfo.event_type` when a server has received a request."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Intrinsics as a camera published them."""

    K: np.ndarray
    """(3, 3) float64, pixels."""
    width: int
    height: int
    frame: str
    """Optical frame."""
    distorted: bool
    """Whether the pictures are not rectified."""


def pose_of(message: Any, topic: str) -> np.ndarray:
    """Pose (4, 4) float64 of `Pose`, `PoseStamped`, `PoseInFrame`, `Odometry`, `Transform`, ...

    Raises:
        DatasetError: The message holds no pose.
    """
    inner = message
    for _ in range(3):
        for position, rotation in (("position", "orientation"), ("translation", "rotation")):
            if hasattr(inner, position) and hasattr(inner, rotation):
                return _transform(getattr(inner, position), getattr(inner, rotation))
        inner = getattr(inner, "pose", getattr(inner, "transform", inner))
    raise DatasetError(
        f"topic '{topic}': expected poses, got messages with the fields {_fields(message)}"
    )


def transforms_of(message: Any) -> list[tuple[str, str, np.ndarray, Any]]:
    """Parent, child, T_parent_child (4, 4) and the single transform, of one or many transforms."""
    found = []
    for item in getattr(message, "transforms", (message,)):
        parent = getattr(item, "parent_frame_id", None)
        if parent is None:
            parent = item.header.frame_id
        T = pose_of(item, "tf")
        found.append((_frame(parent), _frame(item.child_frame_id), T, item))
    return found


def joints_of(message: Any, topic: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and values (n,) float64 of joint states, arrays and single numbers.

    Numbers without names are called by their place: `0`, `1`, ... A `JointTrajectory` gives its
    first point.

    Raises:
        DatasetError: The message holds no numbers.
    """
    if hasattr(message, "joint_names") and hasattr(message, "points"):
        return tuple(message.joint_names), np.array(message.points[0].positions, np.float64)
    if hasattr(message, "position") and hasattr(message, "name"):
        return tuple(message.name), np.array(message.position, np.float64)
    for field in ("data", "value", "values", "position", "width", "positions"):
        if hasattr(message, field):
            values = np.atleast_1d(np.asarray(getattr(message, field), np.float64))
            if values.ndim == 1:
                return tuple(str(i) for i in range(len(values))), values
    raise DatasetError(
        f"topic '{topic}': expected joint states or numbers, got messages with the fields "
        f"{_fields(message)}"
    )


def text_of(message: Any) -> str | None:
    """What a marker says: text, `true` or `false`, a number; None when it does not count.

    Of a service's events only requests that a server has received count.
    """
    info = getattr(message, "info", None)
    if info is not None and hasattr(info, "event_type"):
        if int(info.event_type) != REQUEST_RECEIVED:
            return None
        requests = list(getattr(message, "request", ()))
        return text_of(requests[0]) if requests else ""
    value = getattr(message, "data", getattr(message, "text", ""))
    if isinstance(value, (bool, np.bool_)):
        return str(bool(value)).lower()
    return str(value)


def calibration_of(message: Any, topic: str) -> Calibration:
    """Intrinsics of `CameraInfo` or `CameraCalibration`; those after rectification when given.

    Raises:
        DatasetError: The message is neither, or the camera was never calibrated (K is zero).
    """
    matrix = next((getattr(message, n) for n in ("k", "K") if hasattr(message, n)), None)
    if matrix is None:
        raise DatasetError(
            f"topic '{topic}': expected CameraInfo, got messages with the fields {_fields(message)}"
        )
    K = np.array(matrix, np.float64).reshape(-1)
    if K.size != 9 or K[0] <= 0 or K[4] <= 0:
        raise DatasetError(
            f"topic '{topic}': the camera was never calibrated, its K is {K.tolist()}; give K in "
            "the import.yaml"
        )
    header = getattr(message, "header", message)
    distortion = np.array(getattr(message, "d", getattr(message, "D", ())), np.float64)
    return Calibration(
        K.reshape(3, 3),
        int(message.width),
        int(message.height),
        _frame(getattr(header, "frame_id", "")),
        bool(distortion.size and np.any(np.abs(distortion) > 1e-9)),
    )


def frame_of(message: Any) -> str:
    """The frame that a message speaks of; empty when it names none."""
    return _frame(getattr(getattr(message, "header", message), "frame_id", ""))


def _transform(position: Any, rotation: Any) -> np.ndarray:
    quat = np.array([rotation.w, rotation.x, rotation.y, rotation.z], np.float64)
    if not np.linalg.norm(quat) > 1e-6:
        raise DatasetError("a pose has a quaternion of zeros")
    return pose_to_transform(
        np.array([position.x, position.y, position.z], np.float64), quat / np.linalg.norm(quat)
    )


def _frame(name: str) -> str:
    """ROS 1 names may start with a slash."""
    return name.lstrip("/")


def _fields(message: Any) -> str:
    names = getattr(message, "__dataclass_fields__", None) or getattr(message, "__dict__", None)
    if names is None:
        names = getattr(getattr(message, "DESCRIPTOR", None), "fields_by_name", None)
    return ", ".join(n for n in names or () if not n.startswith("__")) or "none"
