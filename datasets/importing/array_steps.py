"""The steps of one episode of a format with one row per frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from codediffuser.datagen.episode_format import Camera, CameraRecord, MotionRecord
from codediffuser.datagen.log_step import LogStep, Pictures, StoredPicture
from codediffuser.datasets.importing.array_file import ArrayFile
from codediffuser.datasets.importing.config import (
    CameraSource,
    ImportConfig,
    NumberSource,
    PoseSource,
)
from codediffuser.datasets.importing.motion import (
    FINGER,
    hand_row,
    opening_of,
    pose_from_columns,
)
from codediffuser.datasets.importing.pictures import decode_color, to_millimetres
from codediffuser.datasets.importing.stored_pictures import stored_picture
from codediffuser.errors import DatasetError

STILL_M = 1e-6
"""A camera whose pose changes by less stands still."""


class ArraySteps:
    """Everything that `write_episode` needs of one episode.

    Args:
        file: Stays open as long as steps are taken.
        episode: Its name in the file.
        config: The configuration; topics are paths of data sets.

    Raises:
        DatasetError: A data set is missing or has another shape.
    """

    def __init__(self, file: ArrayFile, episode: str, config: ImportConfig) -> None:
        self._file = file
        self._config = config
        self._columns = file.columns(episode)
        self._episode = episode
        self.notes: list[str] = []
        self._check_paths()
        lengths = {c.length for c in self._columns.values()}
        self._count = min(lengths) if lengths else 0
        if not self._count:
            raise DatasetError(f"{file.path}: {episode} has no frames")
        self.joint_names = self._joint_names()
        self.motion = self._motion()
        self.cameras: dict[str, Camera] = {}
        self.records: list[CameraRecord] = []
        self._poses: dict[str, np.ndarray] = {}
        for name, source in config.cameras.items():
            self._add_camera(name, source)

    @property
    def num_steps(self) -> int:
        """How many steps there will be."""
        return self._count - (self._config.action.origin == "next_state")

    def steps(self) -> Iterator[LogStep]:
        """The steps in time order; with actions from the next state the last frame gives none."""
        for k in range(self.num_steps):
            if self._config.action.origin == "next_state":
                action = self._row(k + 1, self._config.state)
            else:
                action = self._row(k, self._config.action)
            joints = self._joints(k)
            yield LogStep(
                qpos=joints,
                qvel=np.zeros_like(joints),
                T_world_hand=self._hand(k) if self.motion.kind == "hand" else None,
                action=action,
                pictures=self._pictures(k),
                T_world_camera={n: T[k] for n, T in self._poses.items()},
            )

    def _check_paths(self) -> None:
        config = self._config
        parts = [config.state.joints, config.state.hand, config.state.gripper,
                 config.action.joints, config.action.hand, config.action.gripper]  # fmt: skip
        wanted = [p for part in parts if part is not None for p in _paths(part.topic)]
        for camera in config.cameras.values():
            wanted += [camera.color] + ([camera.depth] if camera.depth else [])
        missing = [path for path in dict.fromkeys(wanted) if path not in self._columns]
        if missing:
            raise DatasetError(
                f"{self._file.path}: {self._episode} has no data set {', '.join(missing)} with a "
                f"row per frame; it has {', '.join(sorted(self._columns))}"
            )
        frames = [p.frame for p in (config.state.hand, config.action.hand) if p and p.frame]
        if frames:
            raise DatasetError(f"{self._file.path}: has no transform tree to find {frames[0]} in")

    # ------------------------------------------------------------------ joints, state and actions

    def _numbers(self, source: NumberSource | PoseSource, k: int) -> np.ndarray:
        """Columns of all data sets of a source at one frame, (n,) float64, not scaled."""
        rows = [np.atleast_1d(self._columns[p].row(k)).reshape(-1) for p in _paths(source.topic)]
        row = np.concatenate(rows).astype(np.float64)
        return row if source.columns is None else row[slice(*source.columns)]

    def _joint_names(self) -> tuple[str, ...]:
        source = self._config.state.joints
        names = () if source is None else self._names_of(source, "state.joints")
        return names if self._config.motion_kind == "joints" else (*names, FINGER)

    def _names_of(self, source: NumberSource, where: str) -> tuple[str, ...]:
        """The configured names, or paths with numbers."""
        count = len(self._numbers(source, 0))
        if source.joints:
            if len(source.joints) != count:
                raise DatasetError(
                    f"{where}: {len(source.joints)} names for {count} numbers in "
                    f"{', '.join(_paths(source.topic))}; set joints or columns"
                )
            return source.joints
        stem = _paths(source.topic)[0].rpartition("/")[2]
        return tuple(f"{stem}_{i}" for i in range(count))

    def _motion(self) -> MotionRecord:
        if self._config.motion_kind == "hand":
            return MotionRecord(gripper_joints=(FINGER,))
        action = self._config.action.joints
        names = self.joint_names if action is None else self._names_of(action, "action.joints")
        return MotionRecord(kind="joints", state_names=self.joint_names, action_names=names)

    def _joints(self, k: int) -> np.ndarray:
        source, gripper = self._config.state.joints, self._config.state.gripper
        joints = np.zeros(0) if source is None else self._numbers(source, k) * source.scale
        if gripper is None:
            return joints
        return np.append(joints, opening_of(self._numbers(gripper, k), gripper.scale))

    def _hand(self, k: int) -> np.ndarray:
        source = self._config.state.hand
        assert source is not None
        return pose_from_columns(self._numbers(source, k), source.layout, "state.hand")

    def _row(self, k: int, part: Any) -> np.ndarray:
        """A row of state or actions, from the configuration of either."""
        if self.motion.kind == "joints":
            numbers: np.ndarray = self._numbers(part.joints, k) * part.joints.scale
            return numbers.astype(np.float32)
        T = pose_from_columns(self._numbers(part.hand, k), part.hand.layout, "action.hand")
        return hand_row(T, opening_of(self._numbers(part.gripper, k), part.gripper.scale))

    # ------------------------------------------------------------------------------------- cameras

    def _add_camera(self, name: str, source: CameraSource) -> None:
        height, width = self._color(source, 0).shape[:2]
        K = None if source.K is None else np.array(source.K, np.float64)
        poses = None
        if source.T_world_camera is not None:
            poses = np.array([source.T_world_camera], np.float64)
        if source.info is not None:
            found, of_frames = self._file.calibration(self._episode, source.info)
            K, poses = (found if K is None else K), (of_frames if poses is None else poses)
        moving = poses is not None and bool(np.abs(poses - poses[0]).max() > STILL_M)
        if K is not None and poses is not None:
            self.cameras[name] = Camera(K, poses[0], width, height)
            if moving:
                self._poses[name] = poses
        else:
            self.notes.append(f"camera {name} is not calibrated")
        self.records.append(
            CameraRecord(
                name=name, width=width, height=height, depth=source.depth is not None,
                calibrated=name in self.cameras, moving=name in self._poses,
            )
        )  # fmt: skip

    def _pictures(self, k: int) -> Pictures:
        cameras = self._config.cameras
        return Pictures(
            rgb={name: self._color(source, k) for name, source in cameras.items()},
            depth_mm={
                name: to_millimetres(_plane(self._columns[s.depth].row(k), s.depth), s.depth_unit_m)
                for name, s in cameras.items()
                if s.depth is not None
            },
        )

    def _color(self, source: CameraSource, k: int) -> np.ndarray | StoredPicture:
        """Colour (H, W, 3) uint8 RGB of a bare or a compressed row."""
        column = self._columns[source.color]
        row = column.row(k)
        if isinstance(row, bytes) or np.ndim(row) == 1:
            data = row if isinstance(row, bytes) else np.asarray(row, np.uint8).tobytes()
            kept = stored_picture(data, self._config.image) if source.channels == "rgb" else None
            return decode_color(data, source.color, source.channels) if kept is None else kept
        pixels = np.asarray(row)
        if pixels.ndim != 3 or 3 not in (pixels.shape[0], pixels.shape[2]):
            raise DatasetError(
                f"{source.color}: expected pictures (H, W, 3) or (3, H, W), got {pixels.shape}"
            )
        if pixels.shape[2] != 3:
            pixels = np.moveaxis(pixels, 0, 2)
        if pixels.dtype != np.uint8:
            # Some write floats, 0 to 1 or 0 to 255.
            top = 1.0 if float(pixels.max(initial=0)) <= 1.0 else 255.0
            pixels = np.clip(np.rint(pixels * (255.0 / top)), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(pixels[..., ::-1] if source.channels == "bgr" else pixels)


def _plane(row: Any, path: str) -> np.ndarray:
    depth = np.asarray(row)
    depth = depth[..., 0] if depth.ndim == 3 and depth.shape[2] == 1 else depth
    if depth.ndim != 2:
        raise DatasetError(f"{path}: expected depth (H, W) or (H, W, 1), got {depth.shape}")
    return depth


def _paths(topic: str | tuple[str, ...]) -> tuple[str, ...]:
    return (topic,) if isinstance(topic, str) else topic
