"""Writes one episode folder, whole or not at all: log, scene, states, manifest."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Literal, Self

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2.metadata import dump_qos_v8

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen import ros_messages as ros
from codediffuser.datagen.episode_format import (
    Camera,
    CameraRecord,
    ConditionRecord,
    EpisodeManifest,
    FileRecord,
    ImageOptions,
    MotionRecord,
    RecordingRecord,
)
from codediffuser.datagen.scene import SeedKey
from codediffuser.datagen.trajectory import CONTROL_HZ, Trajectory
from codediffuser.errors import EpisodeError, ShapeError
from codediffuser.files import atomic_folder, sha256_file
from codediffuser.manifest import git_commit, versions
from codediffuser.poses import make_transform, rot6d_to_matrix
from codediffuser.schema import Document

# About one step of five 320x240 cameras: one frame is read by unpacking one or two chunks.
CHUNK_BYTES = 1 << 20
NANOSECONDS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class StoredPicture:
    """A colour picture that is compressed already, and is kept byte for byte."""

    data: bytes
    """A JPEG or PNG file."""
    format: Literal["jpeg", "png"]
    height: int
    width: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """(H, W, 3), as of the picture in it."""
        return self.height, self.width, 3


@dataclass(frozen=True, slots=True)
class Pictures:
    """What the cameras saw at one moment, by camera name."""

    rgb: Mapping[str, np.ndarray | StoredPicture]
    """(H, W, 3) uint8, or as it was recorded."""
    depth_mm: Mapping[str, np.ndarray]
    """(H, W) uint16, 0 for no reading."""


@dataclass(frozen=True, slots=True)
class LogStep:
    """One control step: what was sensed, then what was commanded."""

    qpos: np.ndarray
    """(n,) float64, rad or m."""
    qvel: np.ndarray
    """(n,) float64, rad/s or m/s."""
    T_world_hand: np.ndarray | None
    """(4, 4) float64; None when the episode's motion is of kind `joints`."""
    action: np.ndarray
    """(10,) float32, see `trajectory.ACTION_NAMES`; for joints (m,), as the motion names them."""
    pictures: Pictures
    T_world_camera: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(4, 4) float64 of every moving camera."""


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """What the manifest says that the log does not."""

    id: str
    task: str
    source: Literal["simulation", "real"]
    instruction: str
    success: bool
    seed: SeedKey | None = None
    reason: str = ""
    conditions: tuple[ConditionRecord, ...] = ()
    motion: MotionRecord = field(default_factory=MotionRecord)
    recording: RecordingRecord | None = None


class LogWriter:
    """Writes the messages of one episode in time order; a context manager around a binary stream.

    Args:
        stream: Where the MCAP goes; stays open.
        cameras: Calibration of cameras by name.
        instruction: The sentence that was asked.
        hz: Control steps per second.
        image: How colour is stored.
        joint_names: Names in the order of `LogStep.qpos`.
        motion: What state and actions mean.
        records: What each camera brings at every step; None: all of `cameras`, colour and depth.
    """

    def __init__(
        self,
        stream: BinaryIO,
        cameras: Mapping[str, Camera],
        instruction: str,
        *,
        hz: int = CONTROL_HZ,
        image: ImageOptions | None = None,
        joint_names: tuple[str, ...] = fmt.PANDA_JOINT_NAMES,
        motion: MotionRecord | None = None,
        records: Sequence[CameraRecord] | None = None,
    ) -> None:
        self.num_steps = 0
        self.counts: dict[str, int] = {}
        self.records = camera_records(cameras) if records is None else tuple(records)
        self._cameras = dict(cameras)
        self._motion = motion or MotionRecord()
        self._hz = hz
        self._image = image or ImageOptions()
        self._joint_names = joint_names
        self._schema_ids: dict[str, int] = {}
        self._channel_ids: dict[str, int] = {}
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="ros2", library="codediffuser")
        self._write_static(instruction)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._writer.finish()

    def add_step(self, step: LogStep) -> None:
        """Append one step; its time is its number over `hz`.

        Raises:
            ShapeError: A picture is missing, or an array has not the shape of its contract.
        """
        t = step_time_ns(self.num_steps, self._hz)
        size = len(self._motion.action_names)
        if step.action.shape != (size,):
            raise ShapeError(f"action: expected shape ({size},), got {step.action.shape}")
        self._add(
            fmt.JOINT_STATES,
            ros.JOINT_STATE,
            ros.encode_joint_state(self._joint_names, step.qpos, step.qvel, t),
            t,
        )
        if step.T_world_hand is not None:
            self._add(fmt.HAND_POSE, ros.POSE_STAMPED, ros.encode_pose(step.T_world_hand, t), t)
        for record in self.records:
            self._add_pictures(record, step.pictures, t)
        moving = {
            fmt.optical_frame(r.name): step.T_world_camera[r.name] for r in self.records if r.moving
        }
        if moving:
            self._add(fmt.TF, ros.TF_MESSAGE, ros.encode_transforms(moving, t), t)
        self._add_command(step.action, t)
        self.num_steps += 1

    def _add_command(self, action: np.ndarray, t: int) -> None:
        if self._motion.kind == "joints":
            names = self._motion.action_names
            command = ros.encode_joint_state(names, action, np.zeros(len(names)), t)
            self._add(fmt.COMMAND_JOINTS, ros.JOINT_STATE, command, t)
            return
        T_world_command = make_transform(rot6d_to_matrix(action[3:9]), action[:3])
        self._add(fmt.COMMAND_POSE, ros.POSE_STAMPED, ros.encode_pose(T_world_command, t), t)
        self._add(fmt.COMMAND_GRIPPER, ros.FLOAT64, ros.encode_float(action[9]), t)

    def _add_pictures(self, record: CameraRecord, pictures: Pictures, t: int) -> None:
        name = record.name
        kinds: list[tuple[str, Mapping[str, np.ndarray | StoredPicture] | Mapping[str, np.ndarray]]]
        kinds = [("rgb", pictures.rgb)]
        if record.depth:
            kinds.append(("depth_mm", pictures.depth_mm))
        for kind, images in kinds:
            if name not in images:
                raise ShapeError(f"step {self.num_steps}: no {kind} picture of camera '{name}'")
            if images[name].shape[:2] != (record.height, record.width):
                raise ShapeError(
                    f"step {self.num_steps}: {kind} of camera '{name}': expected "
                    f"{(record.height, record.width)}, got {images[name].shape[:2]}"
                )
        frame = fmt.optical_frame(name)
        rgb = pictures.rgb[name]
        if isinstance(rgb, StoredPicture):
            color = ros.pack_color(rgb.data, rgb.format, t, frame)
        else:
            color = ros.encode_color(rgb, t, frame, self._image)
        self._add(fmt.color_topic(name), ros.COMPRESSED_IMAGE, color, t)
        if record.depth:
            depth = ros.encode_depth(pictures.depth_mm[name], t, frame)
            self._add(fmt.depth_topic(name), ros.IMAGE, depth, t)

    def _write_static(self, instruction: str) -> None:
        moving = {r.name for r in self.records if r.moving}
        poses = {
            fmt.optical_frame(n): c.T_world_camera
            for n, c in self._cameras.items()
            if n not in moving
        }
        transforms = ros.encode_transforms(poses)
        self._add(fmt.TF_STATIC, ros.TF_MESSAGE, transforms, 0, latched=True)
        self._add(fmt.INSTRUCTION, ros.STRING, ros.encode_string(instruction), 0, latched=True)
        for name, camera in self._cameras.items():
            info = ros.encode_camera_info(camera, fmt.optical_frame(name))
            self._add(fmt.info_topic(name), ros.CAMERA_INFO, info, 0, latched=True)

    def _add(
        self, topic: str, type_name: str, data: bytes, time_ns: int, *, latched: bool = False
    ) -> None:
        if topic not in self._channel_ids:
            self._register(topic, type_name, latched)
        self._writer.add_message(
            channel_id=self._channel_ids[topic],
            log_time=time_ns,
            publish_time=time_ns,
            sequence=self.counts[topic],
            data=data,
        )
        self.counts[topic] += 1

    def _register(self, topic: str, type_name: str, latched: bool) -> None:
        if type_name not in self._schema_ids:
            self._schema_ids[type_name] = self._writer.register_schema(
                name=type_name, encoding="ros2msg", data=ros.definition(type_name)
            )
        self._channel_ids[topic] = self._writer.register_channel(
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schema_ids[type_name],
            metadata={"offered_qos_profiles": _qos(latched)},
        )
        self.counts[topic] = 0


def camera_records(cameras: Mapping[str, Camera]) -> tuple[CameraRecord, ...]:
    """Cameras that stand still and give colour and depth."""
    return tuple(CameraRecord(name=n, width=c.width, height=c.height) for n, c in cameras.items())


def step_time_ns(step: int, hz: int) -> int:
    """Simulated time of a step in nanoseconds, rounded to the nearest."""
    return (step * NANOSECONDS + hz // 2) // hz


def trajectory_steps(trajectory: Trajectory, pictures: Iterable[Pictures]) -> Iterator[LogStep]:
    """Join a trajectory of T actions with T sets of pictures, one for each moment but the last.

    Raises:
        EpisodeError: There are fewer or more sets of pictures than actions.
    """
    given = iter(pictures)
    for k in range(trajectory.num_steps):
        seen = next(given, None)
        if seen is None:
            raise EpisodeError(f"expected {trajectory.num_steps} sets of pictures, got {k}")
        yield LogStep(
            qpos=trajectory.qpos[k],
            qvel=trajectory.qvel[k],
            T_world_hand=trajectory.T_world_hand(k),
            action=trajectory.actions[k],
            pictures=seen,
        )
    if next(given, None) is not None:
        raise EpisodeError(f"expected {trajectory.num_steps} sets of pictures, got more")


def write_episode(
    folder: Path,
    facts: EpisodeFacts,
    cameras: Mapping[str, Camera],
    steps: Iterable[LogStep],
    *,
    hz: int = CONTROL_HZ,
    image: ImageOptions | None = None,
    joint_names: tuple[str, ...] = fmt.PANDA_JOINT_NAMES,
    scene_file: Path | None = None,
    trajectory: Trajectory | None = None,
    sync: Callable[[], Mapping[str, np.ndarray]] | None = None,
    records: Sequence[CameraRecord] | None = None,
    documents: Mapping[str, Document] | None = None,
    keep: Iterable[Path] = (),
) -> EpisodeManifest:
    """Write an episode folder whole or not at all; an older folder of that name is replaced.

    Args:
        folder: `RUN/episodes/<id>`.
        facts: What the manifest says of it.
        cameras: Calibration by camera name.
        steps: Control steps in time order; consumed as they are written.
        hz: Control steps per second.
        image: How colour is stored.
        joint_names: Names in the order of `LogStep.qpos`.
        scene_file: The scene it was reset to, copied byte for byte.
        trajectory: Simulator states, stored beside the log.
        sync: Gives, once all steps are consumed, the arrays of `sync.npz`.
        records: What each camera brings at every step; None: all of `cameras`, colour and depth.
        documents: Further records by file name, written and listed.
        keep: Further files that are copied into the folder and not listed, such as labels.

    Raises:
        EpisodeError: No step was given, or what was written does not read back.
        ShapeError: A step does not follow its contract.
    """
    image = image or ImageOptions()
    with atomic_folder(folder) as partial:
        with (partial / fmt.LOG).open("wb") as stream:
            log = LogWriter(
                stream, cameras, facts.instruction, hz=hz, image=image,
                joint_names=joint_names, motion=facts.motion, records=records,
            )  # fmt: skip
            with log:
                for step in steps:
                    log.add_step(step)
        if log.num_steps == 0:
            raise EpisodeError(f"{folder}: an episode needs at least one step, got none")
        _verify_log(partial / fmt.LOG, log.counts)
        if scene_file is not None:
            shutil.copyfile(scene_file, partial / fmt.SCENE)
        if trajectory is not None:
            trajectory.save(partial / fmt.STATES)
        if sync is not None:
            np.savez(partial / fmt.SYNC, **dict(sync()))  # type: ignore[arg-type]
        for name, document in (documents or {}).items():
            document.save(partial / name)
        manifest = _manifest(partial, facts, log, hz, image)
        manifest.save(partial / fmt.MANIFEST)
        for path in keep:
            shutil.copyfile(path, partial / path.name)
    return manifest


def _manifest(
    partial: Path,
    facts: EpisodeFacts,
    log: LogWriter,
    hz: int,
    image: ImageOptions,
) -> EpisodeManifest:
    files = {
        path.name: FileRecord(bytes=path.stat().st_size, sha256=sha256_file(path))
        for path in sorted(partial.iterdir())
    }
    return EpisodeManifest(
        id=facts.id,
        task=facts.task,
        source=facts.source,
        seed=facts.seed,
        instruction=facts.instruction,
        success=facts.success,
        reason=facts.reason,
        conditions=facts.conditions,
        frames=log.num_steps,
        hz=hz,
        cameras=log.records,
        motion=facts.motion,
        recording=facts.recording,
        image=image,
        topics=log.counts,
        versions=versions(),
        git_commit=git_commit(),
        files=files,
    )


def _verify_log(path: Path, expected: Mapping[str, int]) -> None:
    """Read every message back, checksums included, and count by topic."""
    counts = dict.fromkeys(expected, 0)
    with path.open("rb") as stream:
        for _, channel, _ in make_reader(stream, validate_crcs=True).iter_messages():
            counts[channel.topic] += 1
    if counts != dict(expected):
        raise EpisodeError(f"{path}: wrote {dict(expected)} messages, read back {counts}")


def _qos(latched: bool) -> str:
    """How `ros2 bag play` offers a topic: latched ones also reach subscribers that come late."""
    unset = QosTime(0, 0)
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    profile = Qos(
        QosHistory.KEEP_LAST, 1 if latched else 10, QosReliability.RELIABLE, durability,
        unset, unset, QosLiveliness.SYSTEM_DEFAULT, unset, False,
    )  # fmt: skip
    return dump_qos_v8([profile])
