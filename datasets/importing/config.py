"""What an `import.yaml` says: where signals are, how they meet on one clock, where episodes end."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from codediffuser.datagen.episode_format import ImageOptions
from codediffuser.schema import Document, Strict

Row4 = tuple[float, float, float, float]
Row3 = tuple[float, float, float]
PoseLayout = Literal["xyz_quat_wxyz", "xyz_quat_xyzw", "xyz_rotvec", "xyz_rot6d"]
Clock = Literal["bag", "header"]


class SyncConfig(Strict):
    """How the signals of a bag meet on one clock. Formats with one row per frame need none."""

    reference: str = ""
    """Topic whose messages are the frames; empty: frames come at `hz`."""
    clock: Clock = "bag"
    """`bag`: when a message was received. `header`: when its sender stamped it; messages without
    a stamp keep their bag time."""
    max_age_s: float = Field(default=0.1, gt=0)
    """A message older than this at its frame is stale."""
    on_stale: Literal["drop", "hold"] = "drop"
    """Leave a frame with a stale signal out, or keep it with the old value. Both are counted."""


class Limits(Strict):
    """An episode beyond one of these is refused, with the reason in the report."""

    min_frames: int = Field(default=2, ge=1)
    max_dropped_share: float = Field(default=0.05, ge=0, le=1)
    max_held_share: float = Field(default=0.2, ge=0, le=1)
    max_skew_p95_s: float = Field(default=0.1, gt=0)
    max_missing_share: float = Field(default=0.2, ge=0, le=1)
    """Of the messages that a topic's own rate would have brought."""


class CameraSource(Strict):
    """One camera. Topics are paths inside the file where the source is HDF5 or zarr."""

    color: str
    depth: str | None = None
    depth_unit_m: float | None = None
    """Metres per depth count; None: 0.001 for integers, 1 for floats."""
    info: str | None = None
    """Topic of `CameraInfo`; or give K."""
    frame: str | None = None
    """Optical frame (OpenCV axes) in the transform tree; None: that of the messages."""
    K: tuple[Row3, Row3, Row3] | None = None
    """Intrinsics in pixels."""
    T_world_camera: tuple[Row4, Row4, Row4, Row4] | None = None
    """Pose, OpenCV axes; goes before the transform tree."""
    moving: bool = False
    """Whether the pose is looked up for every frame, as for a camera on a hand."""
    channels: Literal["rgb", "bgr"] = "rgb"
    """Order of bare arrays, and what a JPEG was made from; messages name their own order."""
    max_age_s: float | None = None


class PoseSource(Strict):
    """Where a pose in the world comes from: a topic, a frame of the transform tree, or columns."""

    topic: str | tuple[str, ...] = ()
    """Topic of poses; in HDF5 and zarr one or several data sets whose columns are joined."""
    frame: str | None = None
    """Frame in the transform tree, instead of a topic."""
    columns: tuple[int, int] | None = None
    """First column and the one after the last, for bare arrays."""
    layout: PoseLayout = "xyz_quat_wxyz"
    """What the columns of bare arrays are."""
    interpolate: bool = False
    """Between the neighbours of a frame, so not causal; else the latest before it."""
    max_age_s: float | None = None

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if bool(self.topic) == bool(self.frame):
            raise ValueError("give either a topic or a frame")
        return self


class NumberSource(Strict):
    """Where numbers come from: a topic of joint states or numbers, or columns of bare arrays."""

    topic: str | tuple[str, ...]
    """In HDF5 and zarr one or several data sets whose columns are joined."""
    joints: tuple[str, ...] = ()
    """Names to take, in this order; empty: all."""
    columns: tuple[int, int] | None = None
    scale: float = 1.0
    """Multiplies each number: brings a gripper to metres."""
    interpolate: bool = False
    max_age_s: float | None = None


class StateSource(Strict):
    """What was measured.

    With `hand` and `gripper` the state is a hand pose and a finger opening; without, it is the
    joints as they are.
    """

    joints: NumberSource | None = None
    hand: PoseSource | None = None
    gripper: NumberSource | None = None
    """Finger opening, metres: the mean of the absolute values of these numbers."""

    @model_validator(mode="after")
    def _enough(self) -> Self:
        if (self.hand is None) != (self.gripper is None):
            raise ValueError("hand and gripper belong together: give both or neither")
        if self.hand is None and self.joints is None:
            raise ValueError("give hand and gripper, or joints")
        return self


class ActionSource(Strict):
    """What was commanded, in the same terms as the state."""

    origin: Literal["command", "next_state"] = Field(default="command", alias="from")
    """A recorded command, or the state of the following frame (which leaves out the last)."""
    when: Literal["frame", "next_frame"] = "frame"
    """The latest command at the frame, or the latest at the following frame, for controllers
    whose command is published after the observation that it answers."""
    hand: PoseSource | None = None
    gripper: NumberSource | None = None
    joints: NumberSource | None = None


class MarkerRule(Strict):
    """A message that means something for the cutting of episodes."""

    topic: str
    """Topic of markers, or of a service's events (`.../_service_event`: a request that was
    received counts)."""
    value: str | None = None
    """Only messages with this content (text, number, `true`); None: any."""
    means: Literal["start", "stop", "success", "failure", "discard"]
    """`success`, `failure` and `discard` also stop the episode that is open."""


class EpisodeCuts(Strict):
    """Where the episodes of a bag start and stop."""

    by: Literal["whole", "markers", "gaps", "times"] = "whole"
    markers: tuple[MarkerRule, ...] = ()
    gap_s: float = Field(default=1.0, gt=0)
    """Silence of `gap_topic` that parts two episodes."""
    gap_topic: str = ""
    """Empty: the first camera."""
    times_s: tuple[tuple[float, float], ...] = ()
    """Start and stop in seconds since the first message of the bag."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.by == "markers" and not any(m.means == "start" for m in self.markers):
            raise ValueError("cutting by markers needs a marker that means start")
        if self.by == "times" and not self.times_s:
            raise ValueError("cutting by times needs times_s")
        return self


class SceneSource(Strict):
    """The configuration that the operator reset each episode to."""

    folder: str
    """Folder of scene files, relative to the import.yaml."""
    by: Literal["order", "file"] = "order"
    """The n-th episode, counted over all sources and refused ones too, takes the n-th scene;
    or `files` says which."""
    files: dict[str, str] = Field(default_factory=dict)
    """`RECORDING#SEGMENT` (file or folder name, number from 0) to the name of a scene file."""


class ImportConfig(Document):
    """How recordings become episodes (`schema: codediffuser.import/1`)."""

    KIND: ClassVar[str] = "import"
    VERSION: ClassVar[int] = 1

    task: str
    source: Literal["real", "simulation"] = "real"
    hz: int = Field(ge=1, le=1000)
    """Frames per second of the episodes."""
    instruction: str = ""
    """The sentence that was asked; a scene's own goes before it."""
    instruction_topic: str = ""
    """Topic of texts: the latest at the start of an episode, or else the first within."""
    success: bool = True
    """Outcome of episodes of which no marker and no file tells."""
    first_id: int = Field(default=0, ge=0)
    """Number of the first episode that has no scene."""
    world_frame: str = "world"
    sync: SyncConfig = SyncConfig()
    limits: Limits = Limits()
    cameras: dict[str, CameraSource] = Field(default_factory=dict)
    state: StateSource
    action: ActionSource
    episodes: EpisodeCuts = EpisodeCuts()
    scenes: SceneSource | None = None
    image: ImageOptions = ImageOptions()

    @model_validator(mode="after")
    def _actions_have_an_origin(self) -> Self:
        action = self.action
        if action.origin == "next_state":
            if action.hand or action.gripper or action.joints:
                raise ValueError("actions from next_state need no topics")
        elif self.state.hand is not None:
            if action.hand is None or action.gripper is None:
                raise ValueError("actions of a hand state need hand and gripper, or next_state")
        elif action.joints is None:
            raise ValueError("actions of a joint state need joints, or next_state")
        return self

    @property
    def motion_kind(self) -> Literal["hand", "joints"]:
        """What rows of state and actions are."""
        return "hand" if self.state.hand is not None else "joints"
