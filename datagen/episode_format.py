"""What an episode folder holds: file names, topics, the manifest, and the camera model.

```
RUN/episodes/000042/
    episode.mcap    everything that was sensed and commanded, ROS 2 messages
    scene.yaml      the configuration it was reset to (simulation)
    states.npz      simulator states per control step (simulation)
    appearance.json what was randomised in its pictures (only if anything was)
    recovery.json   how its hand was pushed (only if it was)
    sync.npz        which message each frame took, and when that was (imported recordings)
    episode.json    the manifest below
```
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from codediffuser.datagen.scene import SeedKey
from codediffuser.datagen.trajectory import ACTION_NAMES
from codediffuser.schema import Document, Raw, Strict

EPISODES = "episodes"
LOG = "episode.mcap"
SCENE = "scene.yaml"
STATES = "states.npz"
SYNC = "sync.npz"
MANIFEST = "episode.json"

TF = "/tf"
TF_STATIC = "/tf_static"
INSTRUCTION = "/instruction"
JOINT_STATES = "/joint_states"
HAND_POSE = "/ee_pose"
COMMAND_POSE = "/command/ee_pose"
COMMAND_GRIPPER = "/command/gripper"
COMMAND_JOINTS = "/command/joint_states"
HAND_TOPICS = (JOINT_STATES, HAND_POSE, COMMAND_POSE, COMMAND_GRIPPER)
JOINT_TOPICS = (JOINT_STATES, COMMAND_JOINTS)
"""Topics with one message per control step, beside the pictures, by `MotionRecord.kind`."""

METRES_PER_MM = np.float32(1e-3)
"""Depth in metres is whole millimetres times this, not divided by 1000: live depth then equals
stored depth bit by bit."""

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


def step_time_ns(step: int, hz: int) -> int:
    """Simulated time of a step in nanoseconds, rounded to the nearest."""
    return (step * 1_000_000_000 + hz // 2) // hz


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
    """How colour pictures are stored. Depth is always lossless.

    A recorded picture that is in this format already is kept byte for byte, at its own quality.
    """

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
    depth: bool = True
    """Whether it gives depth beside colour."""
    calibrated: bool = True
    """Whether the log holds its intrinsics and its pose."""
    moving: bool = False
    """Whether its pose comes with every frame, as for a camera on a hand."""


class MotionRecord(Strict):
    """What a row of state and of actions means."""

    kind: Literal["hand", "joints"] = "hand"
    """`hand`: absolute hand pose in the world and finger opening. `joints`: named numbers as the
    recording gave them, for robots whose hand pose is not known."""
    state_names: tuple[str, ...] = ACTION_NAMES
    action_names: tuple[str, ...] = ACTION_NAMES
    gripper_joints: tuple[str, ...] = ()
    """Joints whose mean is the finger opening; empty: those that have `finger` in their name."""

    @property
    def step_topics(self) -> tuple[str, ...]:
        """Topics with one message per control step, beside the pictures."""
        return HAND_TOPICS if self.kind == "hand" else JOINT_TOPICS


class ConditionRecord(Strict):
    """One measured condition of success, judged on the last state."""

    name: str
    value: float
    threshold: float
    holds: bool


class TopicSync(Strict):
    """How one signal of a recording was brought to the frames. Times in milliseconds."""

    topic: str
    method: Literal["latest", "linear", "next"]
    """`latest`: the newest message not after the frame. `linear`: between two messages, so it is
    not causal. `next`: the newest not after the following frame, for commands alone."""
    clock: Literal["bag", "header"]
    messages: int
    """Messages between the first and the last frame."""
    rate_hz: float
    """From the median interval."""
    skew_p50_ms: float
    skew_p95_ms: float
    skew_max_ms: float
    """Age of the message at its frame."""
    jitter_p95_ms: float
    """Deviation of an interval from the median one."""
    missing: int
    """Messages that the rate would have brought and that did not come."""
    late: int
    """Messages that arrived later after their header stamp than others by a clear margin."""
    reordered: int
    """Messages that arrived after one with a later header stamp."""
    duplicates: int
    """Messages with the header stamp of an earlier one."""
    held_frames: int
    """Frames that use a message older than the limit, because the configuration holds."""
    dropped_frames: int
    """Frames that are left out because this signal was missing or too old."""
    faults: tuple[str, ...] = ()
    """The first of these in words, with seconds since the recording's start."""


class SyncRecord(Strict):
    """How an imported episode was synchronised."""

    clock: Literal["bag", "header"]
    reference: str
    """Topic whose messages are the frames; empty for a fixed rate."""
    max_age_ms: float
    on_stale: Literal["drop", "hold"]
    action: str
    """Where actions come from, in words."""
    dropped_frames: int
    held_frames: int
    signals: dict[str, TopicSync]


class RecordingRecord(Strict):
    """Where an imported episode comes from."""

    path: str
    """Name of the file or folder, without the folders above it."""
    format: str
    segment: int
    """Which of the recording's episodes, from 0."""
    start_ns: int
    stop_ns: int
    """First and last moment on the recording's clock; 0 where a format has none."""
    config_sha256: str
    damage: tuple[str, ...] = ()
    """What of the recording could not be read."""
    sync: SyncRecord | None = None
    """None for formats that store one row per frame."""


class EpisodeManifest(Document):
    """What `episode.json` says (`schema: codediffuser.episode/2`).

    Version 2 adds `motion`, `recording`, and what each camera gives. It holds no time of day: the
    same seed and code give the same bytes.
    """

    KIND: ClassVar[str] = "episode"
    VERSION: ClassVar[int] = 2
    UPGRADES: ClassVar[dict[int, Callable[[Raw], Raw]]] = {1: dict}  # all that is new has defaults

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
    motion: MotionRecord = MotionRecord()
    recording: RecordingRecord | None = None
    """Where an imported episode comes from; None for one that was made here."""
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
