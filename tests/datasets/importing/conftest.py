"""Recordings in memory, written by `rosbags` as any kind of bag; faults are injected into them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from codediffuser.datasets.importing.config import ImportConfig

START_NS = 1_700_000_000_000_000_000
WIDTH, HEIGHT = 32, 24
JOINTS = ("joint_0", "joint_1", "finger_left", "finger_right")
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
STORES[1].register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)


@dataclass(frozen=True)
class Event:
    """One message: sent at `stamp_ns`, received at `bag_ns`."""

    topic: str
    stamp_ns: int
    bag_ns: int
    number: int
    """Which of its topic's messages it is."""


class BagMaker:
    """A small recording: an RGB-D camera, joints, a hand, commands, transforms and markers."""

    def __init__(self, seconds: float = 2.0, camera_hz: int = 30, robot_hz: int = 100) -> None:
        rates = {"/cam/image": camera_hz, "/cam/depth": camera_hz, "/joint_states": robot_hz,
                 "/ee_pose": robot_hz, "/command": robot_hz}  # fmt: skip
        self.events = [
            Event(topic, t, t + 2_000_000, k)
            for topic, hz in rates.items()
            for k in range(int(seconds * hz))
            for t in [START_NS + k * 1_000_000_000 // hz]
        ]
        self.events += [
            Event(topic, START_NS, START_NS, 0) for topic in ("/cam/info", "/tf_static")
        ]

    def add_moving_transforms(self, seconds: float = 2.0, hz: int = 50) -> None:
        """The hand moves in the world, and a camera `wrist` stands on it."""
        for k in range(int(seconds * hz)):
            t = START_NS + k * 1_000_000_000 // hz
            self.events.append(Event("/tf", t, t + 1_000_000, k))

    def change(self, topic: str, number: int, **changes: int) -> None:
        """Shift the times of one message: `delay_ns` when it arrives, `stamp_ns` its stamp."""
        for i, event in enumerate(self.events):
            if event.topic == topic and event.number == number:
                self.events[i] = replace(
                    event,
                    bag_ns=event.bag_ns + changes.get("delay_ns", 0),
                    stamp_ns=event.stamp_ns + changes.get("stamp_ns", 0),
                )

    def drop(self, topic: str, *numbers: int) -> None:
        self.events = [e for e in self.events if e.topic != topic or e.number not in numbers]

    def mark(self, seconds: float, text: str) -> None:
        t = START_NS + int(seconds * 1e9)
        self.events.append(Event(f"/episode {text}", t, t, 0))

    def arrived(self) -> list[Event]:
        return sorted(self.events, key=lambda e: e.bag_ns)

    def write_rosbag2(self, path: Path, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
        store = STORES[2]
        with Writer2(path, version=9, storage_plugin=storage) as writer:
            made: dict[str, Any] = {}
            for event in self.arrived():
                topic, type_name, message = build(event, 2)
                if topic not in made:
                    made[topic] = writer.add_connection(topic, type_name, typestore=store)
                data = store.serialize_cdr(message, type_name)
                writer.write(made[topic], event.bag_ns, data)
        return path

    def write_mcap_of_ros1(self, path: Path) -> Path:
        """ROS 1 messages in MCAP, as `mcap convert` makes them."""
        store, channels = STORES[1], {}
        with path.open("wb") as stream:
            writer = McapWriter(stream)
            writer.start(profile="ros1")
            for event in self.arrived():
                topic, type_name, message = build(event, 1)
                if topic not in channels:
                    text, _ = store.generate_msgdef(type_name, ros_version=1)
                    schema = writer.register_schema(
                        type_name.replace("/msg/", "/"), "ros1msg", text.encode()
                    )
                    channels[topic] = writer.register_channel(topic, "ros1", schema)
                data = bytes(store.serialize_ros1(message, type_name))
                writer.add_message(channels[topic], event.bag_ns, data, event.bag_ns)
            writer.finish()
        return path

    def write_rosbag1(self, path: Path) -> Path:
        store = STORES[1]
        writer = Writer1(path)
        writer.chunk_threshold = 1 << 14
        with writer:
            made: dict[str, Any] = {}
            for event in self.arrived():
                topic, type_name, message = build(event, 1)
                if topic not in made:
                    made[topic] = writer.add_connection(topic, type_name, typestore=store)
                writer.write(made[topic], event.bag_ns, store.serialize_ros1(message, type_name))
        return path


def picture(number: int) -> np.ndarray:
    """(H, W, 3) uint8 that carries its number, and survives no shuffling of channels."""
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[..., 0], pixels[..., 1], pixels[..., 2] = number % 256, 50, 200
    return pixels


def depth(number: int) -> np.ndarray:
    """(H, W) uint16 that carries its number."""
    return np.full((HEIGHT, WIDTH), 500 + number, np.uint16)


def build(event: Event, ros: int) -> tuple[str, str, Any]:
    """Topic, type and message of an event; poses carry their number as x in millimetres."""
    types = STORES[ros].types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(event.stamp_ns, 1_000_000_000))
    first = (event.number,) if ros == 1 else ()

    def header(frame: str) -> Any:
        return types["std_msgs/msg/Header"](*first, stamp, frame)

    def image(encoding: str, pixels: np.ndarray) -> Any:
        return types["sensor_msgs/msg/Image"](
            header("cam_optical"), HEIGHT, WIDTH, encoding, 0, pixels.strides[0],
            pixels.reshape(-1).view(np.uint8),
        )  # fmt: skip

    topic, _, text = event.topic.partition(" ")
    if topic == "/cam/image":
        return topic, "sensor_msgs/msg/Image", image("rgb8", picture(event.number))
    if topic == "/cam/depth":
        return topic, "sensor_msgs/msg/Image", image("16UC1", depth(event.number))
    if topic == "/joint_states":
        q = np.array([event.number * 1e-3, 0.5, 0.01, 0.03])
        message = types["sensor_msgs/msg/JointState"](header(""), list(JOINTS), q, q * 0, q * 0)
        return topic, "sensor_msgs/msg/JointState", message
    if topic in ("/ee_pose", "/command"):
        point = types["geometry_msgs/msg/Point"](event.number * 1e-3, 0.0, 0.2)
        quaternion = types["geometry_msgs/msg/Quaternion"](1.0, 0.0, 0.0, 0.0)
        pose = types["geometry_msgs/msg/Pose"](point, quaternion)
        message = types["geometry_msgs/msg/PoseStamped"](header("world"), pose)
        return topic, "geometry_msgs/msg/PoseStamped", message
    if topic == "/cam/info":
        K = np.array([30.0, 0, 15.5, 0, 30.0, 11.5, 0, 0, 1])
        roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        P = np.zeros(12)
        message = types["sensor_msgs/msg/CameraInfo"](
            header("cam_optical"), HEIGHT, WIDTH, "plumb_bob", np.zeros(5), K,
            np.eye(3).reshape(-1), P, 0, 0, roi,
        )  # fmt: skip
        return topic, "sensor_msgs/msg/CameraInfo", message
    if topic in ("/tf", "/tf_static"):
        type_name = "tf2_msgs/msg/TFMessage"
        zero, half_turn = (0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0)
        edges = [("world", "mast", (0.0, 0.0, 1.0), zero),
                 ("mast", "cam_optical", (0.0, 0.0, 0.2), half_turn),
                 ("tcp", "wrist_optical", (0.0, 0.1, 0.0), zero)]  # fmt: skip
        if topic == "/tf":
            edges = [("world", "tcp", (event.number * 1e-3, 0.0, 0.3), half_turn)]
        return topic, type_name, types[type_name](transforms(types, header, edges))
    return topic, "std_msgs/msg/String", types["std_msgs/msg/String"](text)


def transforms(types: Any, header: Callable[[str], Any], edges: list[tuple[Any, ...]]) -> list[Any]:
    """Transforms from parent, child, translation and rotation (x, y, z, w)."""
    stamped = []
    for parent, child, translation, rotation in edges:
        transform = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](*translation),
            types["geometry_msgs/msg/Quaternion"](*rotation),
        )
        stamped.append(
            types["geometry_msgs/msg/TransformStamped"](header(parent), child, transform)
        )
    return stamped


@pytest.fixture
def bag() -> BagMaker:
    """Two seconds of a healthy recording."""
    return BagMaker()


@pytest.fixture
def make_config() -> Callable[..., ImportConfig]:
    """The configuration that fits `BagMaker`; changes are merged into its top level."""

    def make(**changes: Any) -> ImportConfig:
        raw: dict[str, Any] = {
            "schema": ImportConfig.schema_name(),
            "task": "pack_battery",
            "hz": 20,
            "instruction": "Put the battery in the right slot.",
            "cameras": {"front": {"color": "/cam/image", "depth": "/cam/depth",
                                  "info": "/cam/info"}},
            "state": {
                "joints": {"topic": "/joint_states"},
                "hand": {"topic": "/ee_pose"},
                "gripper": {"topic": "/joint_states", "joints": JOINTS[2:]},
            },
            "action": {
                "from": "command",
                "hand": {"topic": "/command"},
                "gripper": {"topic": "/joint_states", "joints": JOINTS[2:]},
            },
            "image": {"format": "png"},
        }  # fmt: skip
        return ImportConfig.parse(raw | changes, "test")

    return make


@pytest.fixture
def run_import(tmp_path: Path) -> Callable[..., tuple[Path, list[Any]]]:
    """Import in this process; returns the run folder and the results."""
    from codediffuser.datasets.importing.run import import_recordings

    def run(source: Path, config: ImportConfig, **options: Any) -> tuple[Path, list[Any]]:
        folder = options.pop("run", tmp_path / "run")
        return folder, list(import_recordings(source, config, folder, **options))

    return run


def numbers_seen(frames: Iterable[Any]) -> Iterator[int]:
    """Which picture of the camera each frame shows."""
    for frame in frames:
        yield int(frame.rgb["front"][0, 0, 0])


@pytest.fixture
def python() -> str:
    """The interpreter that runs the tests."""
    return sys.executable
