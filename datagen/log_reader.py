"""Reads the log of one episode: an MCAP file of ROS 2 messages, some frames at a time."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from rosbags.serde import SerdeError

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen import ros_messages as ros
from codediffuser.datagen.episode_format import Camera, MotionRecord
from codediffuser.errors import EpisodeError
from codediffuser.poses import matrix_to_rot6d

# All that the libraries below raise on damaged bytes.
READ_ERRORS = (
    McapError, SerdeError, zstandard.ZstdError, struct.error, ValueError, KeyError, OSError,
)  # fmt: skip


class LogReader:
    """Decodes the messages of a log. It holds no open file: every call opens the log.

    Every method raises one of `READ_ERRORS` where bytes are damaged or a topic is missing.

    Args:
        path: The MCAP file.
        hz: Control steps per second.
    """

    def __init__(self, path: Path, hz: int) -> None:
        self.path = path
        self._hz = hz

    def messages(self, topics: Sequence[str], start: int, stop: int) -> Iterator[tuple[str, bytes]]:
        """Topic and content of the messages of frames start <= k < stop, in time order."""
        with self.path.open("rb") as stream:
            messages = make_reader(stream, validate_crcs=True).iter_messages(
                topics=topics,
                starting_at=fmt.step_time_ns(start, self._hz),
                ending_before=fmt.step_time_ns(max(start, stop), self._hz),
            )
            for _, channel, message in messages:
                yield channel.topic, message.data

    def cameras(self, names: Sequence[str]) -> dict[str, Camera]:
        """Calibration of cameras that stand still, in the order of `names`."""
        infos, poses = {}, {}
        topics = [fmt.TF_STATIC, *(fmt.info_topic(n) for n in names)]
        for topic, data in self.messages(topics, 0, 1):
            if topic == fmt.TF_STATIC:
                poses.update(ros.decode_transforms(data))
            else:
                infos[topic] = ros.decode_camera_info(data)
        cameras = {}
        for name in names:
            K, width, height = infos[fmt.info_topic(name)]
            cameras[name] = Camera(K, poses[fmt.optical_frame(name)], width, height)
        return cameras

    def moving_camera_poses(self, name: str, num_frames: int) -> list[np.ndarray]:
        """T_world_camera (4, 4) float64 of the frames that have one."""
        frame = fmt.optical_frame(name)
        messages = self.messages([fmt.TF], 0, num_frames)
        found = [ros.decode_transforms(data) for _, data in messages]
        return [T[frame] for T in found if frame in T]

    def camera_info(self, name: str) -> tuple[np.ndarray, int, int] | None:
        """K (3, 3) float64 in pixels, width and height; None for a camera without calibration."""
        for _, data in self.messages([fmt.info_topic(name)], 0, 1):
            return ros.decode_camera_info(data)
        return None

    def state_and_actions(
        self, motion: MotionRecord, num_frames: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Both (T, n) float32 with the columns that `motion` names, from one pass over the log.

        Raises:
            EpisodeError: A topic has not one message per frame, or no joint is a finger.
        """
        rows: dict[str, list[np.ndarray]] = {topic: [] for topic in motion.step_topics}
        for topic, data in self.messages(motion.step_topics, 0, num_frames):
            rows[topic].append(_low_dim_row(topic, data, motion))
        lengths = {len(found) for found in rows.values()}
        if lengths != {num_frames}:
            raise EpisodeError(
                f"expected {num_frames} messages of each of {', '.join(rows)}, got "
                f"{sorted(lengths)}"
            )
        if motion.kind == "joints":
            state, actions = np.array(rows[fmt.JOINT_STATES]), np.array(rows[fmt.COMMAND_JOINTS])
        else:
            state = np.column_stack([rows[fmt.HAND_POSE], rows[fmt.JOINT_STATES]])
            actions = np.column_stack([rows[fmt.COMMAND_POSE], rows[fmt.COMMAND_GRIPPER]])
        return state.astype(np.float32), actions.astype(np.float32)


def _low_dim_row(topic: str, data: bytes, motion: MotionRecord) -> np.ndarray:
    """What one message adds to the rows of state or actions."""
    if topic in (fmt.HAND_POSE, fmt.COMMAND_POSE):
        T_world_hand = ros.decode_pose(data)
        return np.concatenate([T_world_hand[:3, 3], matrix_to_rot6d(T_world_hand[:3, :3])])
    if topic == fmt.COMMAND_GRIPPER:
        return np.array([ros.decode_float(data)])
    names, values, _ = ros.decode_joint_state(data)
    if motion.kind == "joints":
        return values
    fingers = [
        i
        for i, name in enumerate(names)
        if (name in motion.gripper_joints if motion.gripper_joints else "finger" in name)
    ]
    if not fingers:
        raise EpisodeError(f"joint states name no finger joint: {', '.join(names)}")
    return np.array([values[fingers].mean()])
