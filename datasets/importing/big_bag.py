"""Makes recordings of any size: what a lab with two RGB-D cameras and an arm records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from codediffuser.datagen import ros_messages as ros
from codediffuser.datagen.episode_format import Camera
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.files import atomic_path
from codediffuser.poses import make_transform, pose_to_transform

CAMERAS = ("front", "side")
CAMERA_HZ, ROBOT_HZ = 30, 120
START_NS = 1_700_000_000_000_000_000
_POOL = 16
"""Different noisy pictures; the file cannot be packed, and making it is not limited by them."""


def make_bag(
    path: Path,
    total_bytes: int,
    *,
    episodes: int = 4,
    seed: int = 0,
    size: tuple[int, int] = (640, 480),
    chunk_bytes: int = 4 << 20,
) -> Path:
    """Write an MCAP recording with bare pictures until it has a size.

    Args:
        path: The file.
        total_bytes: About how large; at least a second is written for each episode.
        episodes: How many times `/episode` says start and stop.
        seed: Of the noise.
        size: Width and height of the pictures.
        chunk_bytes: Size of the file's chunks.

    Returns:
        The file.
    """
    frame_bytes = len(CAMERAS) * size[0] * size[1] * 5
    frames = max(total_bytes // frame_bytes, episodes * CAMERA_HZ)
    with atomic_path(path) as partial, partial.open("wb") as stream:
        # Recorders leave pictures as they are: packing them is too slow.
        writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="codediffuser big_bag")
        _Bag(writer, size, np.random.default_rng(seed)).write(frames, episodes)
        writer.finish()
    return path


def bag_config(hz: int) -> ImportConfig:
    """How recordings of `make_bag` are imported."""
    cameras = {
        name: {"color": f"/{name}/image_raw", "depth": f"/{name}/depth", "info": f"/{name}/info"}
        for name in CAMERAS
    }
    markers = [{"topic": "/episode", "value": w, "means": w} for w in ("start", "stop")]
    fingers = {"topic": "/joint_states", "joints": ["finger_left", "finger_right"]}
    return ImportConfig.parse(
        {
            "schema": ImportConfig.schema_name(),
            "task": "pack_battery",
            "hz": hz,
            "instruction": "Put the battery in the right slot.",
            "cameras": cameras,
            "state": {"joints": {"topic": "/joint_states"}, "hand": {"topic": "/ee_pose"},
                      "gripper": fingers},
            "action": {"from": "next_state"},
            "episodes": {
                "by": "markers",
                "markers": markers,
            },
        },
        "big_bag",
    )  # fmt: skip


class _Bag:
    def __init__(self, writer: Writer, size: tuple[int, int], rng: np.random.Generator) -> None:
        self._writer = writer
        self._width, self._height = size
        self._channels: dict[str, int] = {}
        types = get_typestore(Stores.ROS2_HUMBLE)
        self._store, self._types = types, types.types
        noise = rng.integers(0, 256, (_POOL, self._height * self._width * 3), np.uint8)
        self._rgb = list(noise)
        depth = rng.integers(400, 1500, (_POOL, self._height, self._width)).astype(np.uint16)
        self._depth = list(depth)

    def write(self, frames: int, episodes: int) -> None:
        """All messages in the order of their times."""
        self._static()
        per_robot = ROBOT_HZ // CAMERA_HZ
        stops = {(i + 1) * frames // episodes - 1 for i in range(episodes)}
        starts = {i * frames // episodes for i in range(episodes)}
        for k in range(frames):
            time_ns = START_NS + k * 1_000_000_000 // CAMERA_HZ
            for j in range(per_robot):
                self._robot(time_ns + j * 1_000_000_000 // ROBOT_HZ, k + j / per_robot)
            for name in CAMERAS:
                self._pictures(name, time_ns, k)
            if k in starts:
                self._add("/episode", ros.STRING, ros.encode_string("start"), time_ns)
            if k in stops:
                self._add("/episode", ros.STRING, ros.encode_string("stop"), time_ns)

    def _static(self) -> None:
        width, height = self._width, self._height
        K = np.array([[500.0, 0, (width - 1) / 2], [0, 500.0, (height - 1) / 2], [0, 0, 1]])
        poses = {}
        for i, name in enumerate(CAMERAS):
            camera = Camera(K, np.eye(4), width, height)
            info = ros.encode_camera_info(camera, name)
            self._add(f"/{name}/info", ros.CAMERA_INFO, info, START_NS)
            poses[name] = pose_to_transform(np.array([0.3 * i, 0, 1.0]), np.array([0.0, 1, 0, 0]))
        self._add("/tf_static", ros.TF_MESSAGE, ros.encode_transforms(poses), START_NS)

    def _robot(self, time_ns: int, phase: float) -> None:
        joints = np.sin(phase / 30 + np.arange(9))
        joints[7:] = 0.02 + 0.01 * np.sin(phase / 50)
        names = (*(f"joint_{i}" for i in range(7)), "finger_left", "finger_right")
        message = ros.encode_joint_state(names, joints, np.zeros(9), time_ns)
        self._add("/joint_states", ros.JOINT_STATE, message, time_ns)
        T = make_transform(np.eye(3), 0.1 * np.array([np.sin(phase / 40), np.cos(phase / 40), 2]))
        self._add("/ee_pose", ros.POSE_STAMPED, ros.encode_pose(T, time_ns), time_ns)

    def _pictures(self, name: str, time_ns: int, k: int) -> None:
        header = self._types["std_msgs/msg/Header"](
            self._types["builtin_interfaces/msg/Time"](*divmod(time_ns, 1_000_000_000)), name
        )
        message = self._types[ros.IMAGE](
            header, self._height, self._width, "rgb8", 0, 3 * self._width, self._rgb[k % _POOL]
        )
        data = bytes(self._store.serialize_cdr(message, ros.IMAGE))
        self._add(f"/{name}/image_raw", ros.IMAGE, data, time_ns)
        depth = ros.encode_depth(self._depth[k % _POOL], time_ns, name)
        self._add(f"/{name}/depth", ros.IMAGE, depth, time_ns)

    def _add(self, topic: str, type_name: str, data: bytes, time_ns: int) -> None:
        if topic not in self._channels:
            schema = self._writer.register_schema(type_name, "ros2msg", ros.definition(type_name))
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)
