"""What an episode folder holds: file names, topics, the manifest, and the camera model.

```
RUN/episodes/000042/
    episode.mcap    everything that was sensed and commanded, ROS 2 messages
    scene.yaml      the configuration it was reset to (simulation)
    states.npz      simulator states per control step (simulation)
    episode.json    the manifest below
```
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from codediffuser.datagen.scene import SeedKey
from codediffuser.schema import Document, Strict

EPISODES = "episodes"
LOG = "episode.mcap"
SCENE = "scene.yaml"
STATES = "states.npz"
MANIFEST = "episode.json"

TF_STATIC = "/tf_static"
INSTRUCTION = "/instruction"
JOINT_STATES = "/joint_states"
HAND_POSE = "/ee_pose"
COMMAND_POSE = "/command/ee_pose"
COMMAND_GRIPPER = "/command/gripper"
STEP_TOPICS = (JOINT_STATES, HAND_POSE, COMMAND_POSE, COMMAND_GRIPPER)
"""Topics with one message per control step, beside the pictures."""

WORLD_FRAME = "world"
PANDA_JOINT_NAMES = (*(f"panda_joint{i}" for i in range(1, 8)), "panda_finger_joint1",
                     "panda_finger_joint2")  # fmt: skip


def color_topic(camera: str) -> str:
    """Topic of a camera's compressed colour pictures."""
    return f"/camera/{camera}/color/compressed"


def depth_topic(camera: str) -> str:
    """Topic of a camera's depth pictures, millimetres."""
    return f"/camera/{camera}/depth"


def info_topic(camera: str) -> str:
    """Topic of a camera's intrinsics."""
    return f"/camera/{camera}/camera_info"


def optical_frame(camera: str) -> str:
    """Name of a camera's frame with OpenCV axes."""
    return f"{camera}_optical"


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated pinhole camera without distortion."""

    K: np.ndarray
    """(3, 3) float64 intrinsics, pixels; pixel centres lie on whole numbers."""
    T_world_camera: np.ndarray
    """(4, 4) float64 pose, OpenCV axes."""
    width: int
    height: int


class ImageOptions(Strict):
    """How colour pictures are stored. Depth is always lossless."""

    format: Literal["jpeg", "png"] = "jpeg"
    jpeg_quality: int = Field(default=92, ge=1, le=100)
    """Ignored by PNG."""


class FileRecord(Strict):
    """Size and content of one file of the folder."""

    bytes: int
    sha256: str


class CameraRecord(Strict):
    """Name and picture size of one camera."""

    name: str
    width: int
    height: int


class ConditionRecord(Strict):
    """One measured condition of success, judged on the last state."""

    name: str
    value: float
    threshold: float
    holds: bool


class EpisodeManifest(Document):
    """What `episode.json` says (`schema: codediffuser.episode/1`).

    It holds no time of day: the same seed and code give the same bytes.
    """

    KIND: ClassVar[str] = "episode"
    VERSION: ClassVar[int] = 1

    id: str
    task: str
    source: Literal["simulation", "real"]
    seed: SeedKey | None = None
    """Address of the generator that drew the scene; None for a real recording."""
    instruction: str
    success: bool
    reason: str = ""
    """Why it is no success; empty for a success."""
    conditions: tuple[ConditionRecord, ...] = ()
    frames: int
    """T: observations, each followed by one action."""
    hz: int
    cameras: tuple[CameraRecord, ...]
    image: ImageOptions
    topics: dict[str, int]
    """How many messages of each topic the log holds."""
    versions: dict[str, str]
    git_commit: str
    files: dict[str, FileRecord]
    """Every file that was written with the episode; labels come later and are not listed."""

    @property
    def content_hash(self) -> str:
        """SHA-256 of the log: names the recording whatever its folder is called."""
        return self.files[LOG].sha256
