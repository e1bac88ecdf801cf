"""Every key of an exported dataset: name, shape, dtype, unit and what it means.

Only true policy inputs live under `observation.`; LeRobot infers roles from names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from codediffuser.datagen.episode_format import CameraRecord, MotionRecord

POINTS = "observation.points"
"""(N * C,) float32: N points of C = 5 channels, row by row, see `POINT_CHANNELS`."""

STATE = "observation.state"
"""(10,) float32: measured hand pose and mean finger opening, laid out like the action."""

ACTION = "action"
"""(10,) float32: commanded absolute hand pose in the world and finger opening."""

LABELS = "annotation.labels"
"""string: the episode's attention labels as JSON, the same in every frame."""

EPISODE_ID = "annotation.episode_id"
"""string: id of the source episode; ids, never positions, name episodes."""

PROGRAM = "annotation.program"
"""string: the program that the built-in composer writes for the sentence, empty where it refuses
the sentence."""

POINT_CHANNELS = ("x", "y", "z", "attention_pick", "attention_place")
"""World metres, then attention in [0, 1] for each role."""


def image_key(camera: str) -> str:
    """Video of a camera's colour, (H, W, 3) uint8."""
    return f"observation.images.{camera}"


def depth_key(camera: str) -> str:
    """string: depth as 16-bit PNG in base64, millimetres, 0 for no reading; see `picture_of`."""
    return f"depth.{camera}"


def mask_key(camera: str) -> str:
    """string: attention on the picture as 8-bit PNG in base64: 1 pick, 2 place, 3 both."""
    return f"annotation.mask.{camera}"


def intrinsics_key(camera: str) -> str:
    """(9,) float32: K (3, 3) in pixels, row by row; pixel centres lie on whole numbers."""
    return f"calibration.{camera}.K"


def pose_key(camera: str) -> str:
    """(16,) float32: T_world_camera (4, 4), OpenCV axes, row by row."""
    return f"calibration.{camera}.T_world_camera"


@dataclass(frozen=True, slots=True)
class Feature:
    """One column as `info.json` declares it: a vector or a scalar, as edit tools need it."""

    dtype: Literal["float32", "int64", "string"]
    size: int
    """Length of the vector, 1 for a scalar."""
    names: Any = None

    def declaration(self) -> dict[str, Any]:
        """The feature's entry in `info.json`."""
        return {"dtype": self.dtype, "shape": [self.size], "names": self.names}


@dataclass(frozen=True, slots=True)
class VideoFeature:
    """One camera's pictures, which lie in video files beside the columns."""

    width: int
    height: int
    info: Mapping[str, Any]
    """LeRobot's `info` block. Its merge tool refuses datasets whose blocks differ."""

    def declaration(self) -> dict[str, Any]:
        """The feature's entry in `info.json`."""
        return {
            "dtype": "video",
            "shape": [self.height, self.width, 3],
            "names": ["height", "width", "channels"],
            "info": dict(self.info),
        }


def motion_features(motion: MotionRecord) -> dict[str, Feature]:
    """State and action, with the names of their numbers."""
    return {
        STATE: Feature("float32", len(motion.state_names), list(motion.state_names)),
        ACTION: Feature("float32", len(motion.action_names), list(motion.action_names)),
    }


def policy_features(
    num_points: int, cloud: Mapping[str, Any], motion: MotionRecord | None = None
) -> dict[str, Feature]:
    """Features of the `pointcloud` profile in the order of columns, without LeRobot's own.

    Args:
        num_points: N, the points of each cloud.
        cloud: How clouds were made, JSON-like. As names of a feature it survives LeRobot's edit
            tools, which also refuse to merge datasets whose features differ.
        motion: What state and action mean; None for hand poses.
    """
    numbers = len(POINT_CHANNELS) * num_points
    return {
        POINTS: Feature(
            "float32", numbers, {"channels": list(POINT_CHANNELS), "cloud": dict(cloud)}
        ),
        **motion_features(motion or MotionRecord()),
        LABELS: Feature("string", 1),
        EPISODE_ID: Feature("string", 1),
    }


def portable_features(
    cameras: Sequence[CameraRecord], motion: MotionRecord, *, labelled: bool
) -> dict[str, Feature]:
    """Columns of the `portable` profile: all that was recorded besides colour.

    Args:
        cameras: Depth is a column for those that have it, calibration and masks for those that are
            calibrated.
        motion: What state and action mean.
        labelled: Whether the episodes have labels.
    """
    features = motion_features(motion)
    for camera in cameras:
        if camera.depth:
            features[depth_key(camera.name)] = Feature("string", 1)
        if camera.calibrated:
            features[intrinsics_key(camera.name)] = Feature("float32", 9)
            features[pose_key(camera.name)] = Feature("float32", 16)
        if camera.calibrated and labelled:
            features[mask_key(camera.name)] = Feature("string", 1)
    if labelled:
        features[LABELS] = Feature("string", 1)
    return {**features, PROGRAM: Feature("string", 1), EPISODE_ID: Feature("string", 1)}


DEFAULT_FEATURES = {
    "timestamp": Feature("float32", 1),
    "frame_index": Feature("int64", 1),
    "episode_index": Feature("int64", 1),
    "index": Feature("int64", 1),
    "task_index": Feature("int64", 1),
}
"""Columns that every LeRobot dataset has."""
