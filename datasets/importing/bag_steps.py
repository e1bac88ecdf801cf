"""The steps of one episode of a bag, streamed: pictures, joints, poses, commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from codediffuser.datagen.episode_format import Camera, CameraRecord, MotionRecord
from codediffuser.datagen.log_step import LogStep, Pictures
from codediffuser.datasets.importing.bag_readers import (
    JointPicker,
    SignalReader,
    color_reader,
    message_reader,
)
from codediffuser.datasets.importing.bag_sync import SyncedEpisode
from codediffuser.datasets.importing.bag_transforms import read_calibration
from codediffuser.datasets.importing.config import CameraSource, ImportConfig, NumberSource
from codediffuser.datasets.importing.motion import (
    FINGER,
    hand_motion,
    hand_row,
    mix_poses,
    opening_of,
)
from codediffuser.datasets.importing.pictures import depth_mm_of
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.values import frame_of, pose_of
from codediffuser.errors import DatasetError

_Numbers = Callable[[int], np.ndarray]


class BagSteps:
    """Everything that `write_episode` needs of one synchronised episode.

    Args:
        recording: Stays open as long as steps are taken.
        synced: Its frames.
        config: The configuration.

    Raises:
        DatasetError: A camera has no calibration or other sizes, or a message says something else.
    """

    def __init__(self, recording: Recording, synced: SyncedEpisode, config: ImportConfig) -> None:
        self._recording = recording
        self._synced = synced
        self._config = config
        self.notes: list[str] = []
        self._color = {
            name: self._reader(
                f"camera.{name}.color", color_reader(recording, source.color, config.image)
            )
            for name, source in config.cameras.items()
        }
        self._depth = {
            name: self._reader(f"camera.{name}.depth", self._depth_reader(source))
            for name, source in config.cameras.items()
            if source.depth is not None
        }
        self._qpos, self._qvel, self.joint_names = self._joint_readers()
        self._state_numbers, self._action_numbers = self._part("state"), self._part("action")
        self.motion = self._motion()
        self.cameras: dict[str, Camera] = {}
        self.records: list[CameraRecord] = []
        for name, source in config.cameras.items():
            self._add_camera(name, source)

    def steps(self) -> Iterator[LogStep]:
        """The steps in time order; with actions from the next state the last frame gives none."""
        count = len(self._synced.plan.frames_ns)
        if self._config.action.origin == "command":
            for k in range(count):
                yield self._step(k, self._row(k, "action", self._action_numbers))
            return
        state = self._row(0, "state", self._state_numbers)
        for k in range(count - 1):
            sensed = self._sense(k)
            state = self._row(k + 1, "state", self._state_numbers)
            yield self._log_step(sensed, state)

    @property
    def num_steps(self) -> int:
        """How many steps there will be."""
        count = len(self._synced.plan.frames_ns)
        return count if self._config.action.origin == "command" else max(count - 1, 0)

    def _step(self, k: int, action: np.ndarray) -> LogStep:
        return self._log_step(self._sense(k), action)

    def _sense(self, k: int) -> dict[str, Any]:
        """What is measured at a frame: the arguments of a step without its action."""
        qpos, qvel = self._joints(k)
        poses = {}
        for record in self.records:
            if record.moving:
                frame = self._config.cameras[record.name].frame
                assert frame is not None
                poses[record.name] = self._lookup(frame, k)
        return {
            "qpos": qpos,
            "qvel": qvel,
            "T_world_hand": self._hand(k, "state") if self.motion.kind == "hand" else None,
            "pictures": Pictures(
                rgb={name: reader.at(k) for name, reader in self._color.items()},
                depth_mm={name: reader.at(k) for name, reader in self._depth.items()},
            ),
            "T_world_camera": poses,
        }

    @staticmethod
    def _log_step(sensed: dict[str, Any], action: np.ndarray) -> LogStep:
        return LogStep(action=action, **sensed)

    def _reader(
        self, signal: str, read: Callable[[int], Any], mix: Callable[..., Any] | None = None
    ) -> SignalReader[Any]:
        samples = self._synced.plan.samples[signal]
        return SignalReader(self._synced.index[signal], samples, read, mix)

    def _depth_reader(self, source: CameraSource) -> Callable[[int], np.ndarray]:
        assert source.depth is not None
        return message_reader(
            self._recording, source.depth, lambda m, t: depth_mm_of(m, t, source.depth_unit_m)
        )

    # ------------------------------------------------------------------ joints, state and actions

    def _joint_readers(
        self,
    ) -> tuple[SignalReader[np.ndarray] | None, SignalReader[np.ndarray] | None, tuple[str, ...]]:
        source = self._config.state.joints
        if source is None:
            return None, None, (FINGER,)
        picker, topic = JointPicker(source, "state.joints"), str(source.topic)
        names = self._first("state.joints", topic, picker.names)
        motion = self._config.state.gripper
        if motion is not None and FINGER in hand_motion(self._config, names).gripper_joints:
            names = (*names, FINGER)
        read = message_reader(self._recording, topic, picker.values)
        speed = message_reader(self._recording, topic, picker.velocities)
        return (
            self._reader("state.joints", read, _mix_numbers),
            self._reader("state.joints", speed, _mix_numbers),
            names,
        )

    def _joints(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        qpos = self._qpos.at(k) if self._qpos else np.zeros(0)
        qvel = self._qvel.at(k) if self._qvel else np.zeros(0)
        if len(qpos) < len(self.joint_names):
            opening = self._state_numbers["gripper"].at(k)[0]
            return np.append(qpos, opening), np.append(qvel, 0.0)
        return qpos, qvel

    def _part(self, part: str) -> dict[str, SignalReader[Any]]:
        """Readers of the hand, gripper or joints of state or action."""
        source = getattr(self._config, part)
        readers: dict[str, SignalReader[Any]] = {}
        if source.hand is not None and source.hand.topic:
            read = message_reader(self._recording, source.hand.topic, pose_of)
            readers["hand"] = self._reader(f"{part}.hand", read, mix_poses)
        if source.gripper is not None:
            read = self._opening_reader(source.gripper, f"{part}.gripper")
            readers["gripper"] = self._reader(f"{part}.gripper", read, _mix_numbers)
        if source.joints is not None:
            picker = JointPicker(source.joints, f"{part}.joints")
            read = message_reader(self._recording, str(source.joints.topic), picker.values)
            readers["joints"] = self._reader(f"{part}.joints", read, _mix_numbers)
        return readers

    def _opening_reader(self, source: NumberSource, where: str) -> _Numbers:
        picker = JointPicker(source.model_copy(update={"scale": 1.0}), where)

        def convert(message: Any, topic: str) -> np.ndarray:
            return np.array([opening_of(picker.values(message, topic), source.scale)])

        return message_reader(self._recording, str(source.topic), convert)

    def _row(self, k: int, part: str, readers: dict[str, SignalReader[Any]]) -> np.ndarray:
        if self.motion.kind == "joints":
            return np.asarray(readers["joints"].at(k), np.float32)
        return hand_row(self._hand(k, part), float(readers["gripper"].at(k)[0]))

    def _hand(self, k: int, part: str) -> np.ndarray:
        readers = self._state_numbers if part == "state" else self._action_numbers
        if "hand" in readers:
            return np.asarray(readers["hand"].at(k))
        frame = getattr(self._config, part).hand.frame
        return self._lookup(frame, k)

    def _lookup(self, frame: str, k: int) -> np.ndarray:
        time_ns = int(self._synced.plan.frames_ns[k])
        return self._synced.tree.lookup(self._config.world_frame, frame, time_ns).T

    def _motion(self) -> MotionRecord:
        if self._config.motion_kind == "hand":
            return hand_motion(self._config, self.joint_names)
        names, source = self.joint_names, self._config.action.joints
        if source is not None:
            picker = JointPicker(source, "action.joints")
            names = self._first("action.joints", str(source.topic), picker.names)
        return MotionRecord(kind="joints", state_names=self.joint_names, action_names=names)

    def _first(self, signal: str, topic: str, convert: Callable[[Any, str], Any]) -> Any:
        place = int(self._synced.plan.samples[signal].index[0])
        index = int(self._synced.index[signal][place])
        return message_reader(self._recording, topic, convert)(index)

    # ------------------------------------------------------------------------------------- cameras

    def _add_camera(self, name: str, source: CameraSource) -> None:
        height, width = self._color[name].at(0).shape[:2]
        if name in self._depth:
            size = self._depth[name].at(0).shape
            if size != (height, width):
                raise DatasetError(
                    f"camera {name}: depth is {size[1]}x{size[0]} and colour {width}x{height}; "
                    "record depth that is aligned to colour"
                )
        K, frame = self._intrinsics(name, source, width, height)
        T = self._camera_pose(name, source, frame)
        moving = source.moving and T is not None
        if K is not None and T is not None:
            self.cameras[name] = Camera(K, T, width, height)
        else:
            self.notes.append(f"camera {name} is not calibrated")
        self.records.append(
            CameraRecord(
                name=name, width=width, height=height, depth=name in self._depth,
                calibrated=name in self.cameras, moving=moving and name in self.cameras,
            )
        )  # fmt: skip

    def _intrinsics(
        self, name: str, source: CameraSource, width: int, height: int
    ) -> tuple[np.ndarray | None, str]:
        """K and the optical frame as far as they are known."""
        frame = source.frame or ""
        if source.info is None:
            K = None if source.K is None else np.array(source.K, np.float64)
            return K, frame or self._picture_frame(source.color, name)
        start = int(self._recording.times_ns[source.color].min())
        info = read_calibration(self._recording, source.info, start, f"camera {name}")
        if (info.width, info.height) not in ((width, height), (0, 0)):
            raise DatasetError(
                f"camera {name}: '{source.info}' is for {info.width}x{info.height} pixels, the "
                f"pictures have {width}x{height}; name the topic that belongs to them, or give K"
            )
        if info.distorted:
            self.notes.append(
                f"camera {name}: distortion is not removed; record rectified pictures"
            )
        K = info.K if source.K is None else np.array(source.K, np.float64)
        return K, frame or info.frame

    def _picture_frame(self, topic: str, name: str) -> str:
        return str(self._first(f"camera.{name}.color", topic, lambda m, _: frame_of(m)))

    def _camera_pose(self, name: str, source: CameraSource, frame: str) -> np.ndarray | None:
        """Pose at frame 0; None when nothing tells."""
        if source.T_world_camera is not None:
            return np.array(source.T_world_camera, np.float64)
        tree, world = self._synced.tree, self._config.world_frame
        if not frame or frame not in tree.frames or world not in tree.frames:
            return None
        if source.moving and source.frame is None:
            raise DatasetError(f"camera {name}: a moving camera needs frame, e.g. frame: {frame}")
        if tree.is_moving(world, frame) and not source.moving:
            raise DatasetError(
                f"camera {name}: its frame '{frame}' moves in '{world}'; set moving: true and "
                f"frame: {frame}"
            )
        return self._lookup(frame, 0)


def _mix_numbers(a: np.ndarray, b: np.ndarray, weight: float) -> np.ndarray:
    return (1 - weight) * a + weight * b
