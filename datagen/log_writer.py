"""Writes the log of one episode: an MCAP file of ROS 2 messages, in time order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np
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
from codediffuser.datagen.episode_format import Camera, CameraRecord, ImageOptions, MotionRecord
from codediffuser.datagen.log_step import LogStep, Pictures, StoredPicture
from codediffuser.datagen.trajectory import CONTROL_HZ
from codediffuser.errors import ShapeError
from codediffuser.poses import make_transform, rot6d_to_matrix

# About one step of five 320x240 cameras: one frame is read by unpacking one or two chunks.
CHUNK_BYTES = 1 << 20


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
        t = fmt.step_time_ns(self.num_steps, self._hz)
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


def _qos(latched: bool) -> str:
    """How `ros2 bag play` offers a topic: latched ones also reach subscribers that come late."""
    unset = QosTime(0, 0)
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    profile = Qos(
        QosHistory.KEEP_LAST, 1 if latched else 10, QosReliability.RELIABLE, durability,
        unset, unset, QosLiveliness.SYSTEM_DEFAULT, unset, False,
    )  # fmt: skip
    return dump_qos_v8([profile])
