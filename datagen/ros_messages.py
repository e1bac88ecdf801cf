"""ROS 2 messages in CDR, to and from NumPy arrays. No ROS installation is needed.

Each `encode_*` gives the bytes of one message, each `decode_*` reads them back. Definitions come
from the typestore of `rosbags`. Only here do quaternions change from (w, x, y, z) to ROS order.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_typestore

from codediffuser.datagen.episode_format import WORLD_FRAME, Camera, ImageOptions
from codediffuser.errors import EpisodeError, ShapeError
from codediffuser.poses import matrix_to_quat_wxyz, pose_to_transform

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
FLOAT64 = "std_msgs/msg/Float64"
IMAGE = "sensor_msgs/msg/Image"
JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
STRING = "std_msgs/msg/String"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"

# Humble is the oldest supported release; these definitions have not changed since.
_STORE = get_typestore(Stores.ROS2_HUMBLE)
_TYPES = _STORE.types
_EMPTY = np.zeros(0)


@functools.cache
def definition(type_name: str) -> bytes:
    """The message definition with all it depends on, as an MCAP `ros2msg` schema holds it."""
    text, _ = _STORE.generate_msgdef(type_name, ros_version=2)
    return str(text).encode()


def encode_color(
    rgb: np.ndarray, time_ns: int, frame_id: str, options: ImageOptions | None = None
) -> bytes:
    """Compress one colour picture.

    Args:
        rgb: (H, W, 3) uint8.
        time_ns: Time of exposure, nanoseconds.
        frame_id: Optical frame of the camera.
        options: Format and quality; None for the defaults.
    """
    options = options or ImageOptions()
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        raise ShapeError(f"rgb of {frame_id}: expected (H, W, 3) uint8, got {_describe(rgb)}")
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    if options.format == "jpeg":
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, options.jpeg_quality])
    else:
        _, data = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return pack_color(data.tobytes(), options.format, time_ns, frame_id)


def pack_color(data: bytes, picture_format: str, time_ns: int, frame_id: str) -> bytes:
    """Pack a picture that is compressed already.

    Args:
        data: The whole JPEG or PNG file.
        picture_format: `jpeg` or `png`.
        time_ns: Time of exposure, nanoseconds.
        frame_id: Optical frame of the camera.
    """
    pixels = np.frombuffer(data, np.uint8)
    message = _TYPES[COMPRESSED_IMAGE](_header(time_ns, frame_id), picture_format, pixels)
    return _encode(message, COMPRESSED_IMAGE)


def decode_color(data: bytes) -> np.ndarray:
    """Decompress one colour picture to (H, W, 3) uint8 RGB."""
    message = _decode(data, COMPRESSED_IMAGE)
    bgr = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
    if bgr is None:
        raise EpisodeError(f"a picture in format '{message.format}' cannot be decompressed")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))


def encode_depth(depth_mm: np.ndarray, time_ns: int, frame_id: str) -> bytes:
    """Pack one depth picture (H, W) uint16, millimetres, 0 for no reading."""
    if depth_mm.ndim != 2 or depth_mm.dtype != np.uint16:
        raise ShapeError(f"depth of {frame_id}: expected (H, W) uint16, got {_describe(depth_mm)}")
    height, width = depth_mm.shape
    little = np.ascontiguousarray(depth_mm, dtype="<u2")
    pixels = little.reshape(-1).view(np.uint8)
    message = _TYPES[IMAGE](
        _header(time_ns, frame_id), height, width, "16UC1", 0, 2 * width, pixels
    )
    return _encode(message, IMAGE)


def decode_depth(data: bytes) -> np.ndarray:
    """Unpack one depth picture to (H, W) uint16, millimetres."""
    message = _decode(data, IMAGE)
    size = message.height * message.width * 2
    if message.encoding != "16UC1" or message.is_bigendian or len(message.data) != size:
        raise EpisodeError(
            f"a depth picture should be little-endian 16UC1 of {size} bytes, got "
            f"{message.encoding} of {len(message.data)} bytes"
        )
    return np.asarray(message.data.view("<u2").reshape(message.height, message.width))


def encode_camera_info(camera: Camera, frame_id: str) -> bytes:
    """Pack the intrinsics of one camera, without distortion."""
    K = np.asarray(camera.K, dtype=np.float64)
    P = np.hstack([K, np.zeros((3, 1))])
    region = _TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    message = _TYPES[CAMERA_INFO](
        _header(0, frame_id), camera.height, camera.width, "plumb_bob", np.zeros(5),
        K.reshape(-1), np.eye(3).reshape(-1), P.reshape(-1), 0, 0, region,
    )  # fmt: skip
    return _encode(message, CAMERA_INFO)


def decode_camera_info(data: bytes) -> tuple[np.ndarray, int, int]:
    """Unpack intrinsics.

    Returns:
        K (3, 3) float64 in pixels, width, height.
    """
    message = _decode(data, CAMERA_INFO)
    return message.k.reshape(3, 3).copy(), int(message.width), int(message.height)


def encode_transforms(T_world_child: Mapping[str, np.ndarray], time_ns: int = 0) -> bytes:
    """Pack poses (4, 4) in the world by the name of their frame."""
    stamped = [
        _TYPES["geometry_msgs/msg/TransformStamped"](
            _header(time_ns, WORLD_FRAME),
            name,
            _TYPES["geometry_msgs/msg/Transform"](
                _TYPES["geometry_msgs/msg/Vector3"](*T[:3, 3].tolist()), _quaternion(T)
            ),
        )
        for name, T in T_world_child.items()
    ]
    return _encode(_TYPES[TF_MESSAGE](stamped), TF_MESSAGE)


def decode_transforms(data: bytes) -> dict[str, np.ndarray]:
    """Unpack poses (4, 4) float64 by the name of their frame.

    Raises:
        EpisodeError: A transform does not start at the world.
    """
    found = {}
    for item in _decode(data, TF_MESSAGE).transforms:
        if item.header.frame_id != WORLD_FRAME:
            raise EpisodeError(
                f"transform: expected '{item.child_frame_id}' in frame '{WORLD_FRAME}', "
                f"got '{item.header.frame_id}'"
            )
        t, q = item.transform.translation, item.transform.rotation
        found[item.child_frame_id] = pose_to_transform(
            np.array([t.x, t.y, t.z]), np.array([q.w, q.x, q.y, q.z])
        )
    return found


def encode_joint_state(
    names: tuple[str, ...], qpos: np.ndarray, qvel: np.ndarray, time_ns: int
) -> bytes:
    """Pack joint positions (n,) in rad or m and velocities (n,)."""
    qpos, qvel = np.asarray(qpos, np.float64), np.asarray(qvel, np.float64)
    if qpos.shape != (len(names),) or qvel.shape != qpos.shape:
        raise ShapeError(
            f"joint state: expected {len(names)} joints, got qpos {qpos.shape}, qvel {qvel.shape}"
        )
    message = _TYPES[JOINT_STATE](_header(time_ns, ""), list(names), qpos, qvel, _EMPTY)
    return _encode(message, JOINT_STATE)


def decode_joint_state(data: bytes) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Unpack names, positions (n,) and velocities (n,) float64."""
    message = _decode(data, JOINT_STATE)
    return tuple(message.name), message.position.copy(), message.velocity.copy()


def encode_pose(T_world_x: np.ndarray, time_ns: int) -> bytes:
    """Pack one pose (4, 4) in the world."""
    pose = _TYPES["geometry_msgs/msg/Pose"](
        _TYPES["geometry_msgs/msg/Point"](*T_world_x[:3, 3].tolist()), _quaternion(T_world_x)
    )
    return _encode(_TYPES[POSE_STAMPED](_header(time_ns, WORLD_FRAME), pose), POSE_STAMPED)


def decode_pose(data: bytes) -> np.ndarray:
    """Unpack one pose (4, 4) float64 in the world."""
    pose = _decode(data, POSE_STAMPED).pose
    p, q = pose.position, pose.orientation
    return pose_to_transform(np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z]))


def encode_float(value: float) -> bytes:
    """Pack one number."""
    return _encode(_TYPES[FLOAT64](float(value)), FLOAT64)


def decode_float(data: bytes) -> float:
    """Unpack one number."""
    return float(_decode(data, FLOAT64).data)


def encode_string(text: str) -> bytes:
    """Pack one text."""
    return _encode(_TYPES[STRING](text), STRING)


def decode_string(data: bytes) -> str:
    """Unpack one text."""
    return str(_decode(data, STRING).data)


def _header(time_ns: int, frame_id: str) -> Any:
    stamp = _TYPES["builtin_interfaces/msg/Time"](*divmod(time_ns, 1_000_000_000))
    return _TYPES["std_msgs/msg/Header"](stamp, frame_id)


def _quaternion(T: np.ndarray) -> Any:
    w, x, y, z = matrix_to_quat_wxyz(T[:3, :3]).tolist()
    return _TYPES["geometry_msgs/msg/Quaternion"](x, y, z, w)


def _encode(message: Any, type_name: str) -> bytes:
    return bytes(_STORE.serialize_cdr(message, type_name, little_endian=True))


def _decode(data: bytes, type_name: str) -> Any:
    return _STORE.deserialize_cdr(data, type_name)


def _describe(array: np.ndarray) -> str:
    return f"{array.shape} {array.dtype}"
