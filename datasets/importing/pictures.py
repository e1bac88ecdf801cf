"""Pixels of picture messages: raw, JPEG, PNG, `compressedDepth`, in all usual encodings.

Source for `compressedDepth`: ros-perception/image_transport_plugins, `compression_common.h`; a
12-byte header (format, two floats of the quantisation) precedes a 16-bit PNG.
"""

from __future__ import annotations

import base64
import struct
from typing import Any

import cv2
import numpy as np

from codediffuser.errors import DatasetError

_COLOR: dict[str, int | None] = {
    "rgb8": None, "bgr8": cv2.COLOR_BGR2RGB, "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB, "mono8": cv2.COLOR_GRAY2RGB, "8uc1": cv2.COLOR_GRAY2RGB,
    "8uc3": cv2.COLOR_BGR2RGB, "8uc4": cv2.COLOR_BGRA2RGB,
    # OpenCV names a mosaic by its second row, ROS by its first.
    "bayer_rggb8": cv2.COLOR_BayerBG2RGB, "bayer_bggr8": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGR2RGB, "bayer_grbg8": cv2.COLOR_BayerGB2RGB,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY, "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUYV, "yuyv": cv2.COLOR_YUV2RGB_YUYV,
}  # fmt: skip
_CHANNELS = {"rgb8": 3, "bgr8": 3, "8uc3": 3, "rgba8": 4, "bgra8": 4, "8uc4": 4,
             "yuv422": 2, "uyvy": 2, "yuv422_yuy2": 2, "yuyv": 2}  # fmt: skip
_DEPTH: dict[str, np.dtype] = {
    "16uc1": np.dtype("u2"), "mono16": np.dtype("u2"), "32fc1": np.dtype("f4"),
}  # fmt: skip
_PNG = b"\x89PNG"
_COMPRESSED_DEPTH = struct.Struct("<iff")


def is_raw(message: Any) -> bool:
    """Whether a picture message holds bare pixels."""
    return hasattr(message, "encoding") and hasattr(message, "height")


def picture_bytes(message: Any) -> bytes:
    """The payload of a picture message; JSON carries it in base 64."""
    data = message.data
    return base64.b64decode(data) if isinstance(data, str) else bytes(data)


def color_of(message: Any, topic: str) -> np.ndarray:
    """Colour (H, W, 3) uint8 RGB of one raw or compressed picture.

    Raises:
        DatasetError: The encoding is not known, or the bytes are damaged.
    """
    if not is_raw(message):
        # image_transport notes in `format` what the pixels were before; decoded they are BGR.
        return decode_color(picture_bytes(message), topic)
    encoding = message.encoding.lower()
    if encoding not in _COLOR:
        raise DatasetError(
            f"topic '{topic}': colour in the encoding '{message.encoding}' cannot be read; known: "
            f"{', '.join(sorted(_COLOR))}"
        )
    pixels = _rows(message, np.dtype("u1"), _CHANNELS.get(encoding, 1), topic)
    code = _COLOR[encoding]
    return np.ascontiguousarray(pixels if code is None else cv2.cvtColor(pixels, code))


def decode_color(data: bytes | np.ndarray, topic: str, channels: str = "rgb") -> np.ndarray:
    """Colour (H, W, 3) uint8 RGB of a JPEG or PNG.

    Args:
        data: The file's bytes.
        topic: For the message.
        channels: `bgr` when it was made from pixels in that order by mistake.
    """
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise DatasetError(f"topic '{topic}': a compressed picture is damaged")
    return np.asarray(bgr if channels == "bgr" else cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))


def depth_mm_of(message: Any, topic: str, unit_m: float | None) -> np.ndarray:
    """Depth (H, W) uint16 in millimetres, 0 for no reading, of one raw or compressed picture.

    Args:
        message: 16UC1 or 32FC1, bare, as PNG, or as `compressedDepth`.
        topic: For the message.
        unit_m: Metres per count; None: 0.001 for integers, 1 for floats.

    Raises:
        DatasetError: The encoding is not known, or the bytes are damaged.
    """
    if is_raw(message):
        encoding = message.encoding.lower()
        if encoding not in _DEPTH:
            raise DatasetError(
                f"topic '{topic}': depth in the encoding '{message.encoding}' cannot be read; "
                "known: 16UC1, mono16, 32FC1"
            )
        return to_millimetres(_rows(message, _DEPTH[encoding], 1, topic), unit_m)
    return to_millimetres(_unpack_depth(message, topic), unit_m)


def to_millimetres(depth: np.ndarray, unit_m: float | None) -> np.ndarray:
    """Depth (H, W) of any number type to uint16 millimetres; no reading and beyond 65 m give 0."""
    if depth.dtype == np.uint16 and unit_m in (None, 0.001):
        return depth
    unit_m = (0.001 if depth.dtype.kind in "iu" else 1.0) if unit_m is None else unit_m
    scaled = depth.astype(np.float64) * (unit_m * 1000)
    usable = np.isfinite(scaled) & (scaled > 0) & (scaled < 65535.5)
    return np.where(usable, np.rint(np.where(usable, scaled, 0)), 0).astype(np.uint16)


def _unpack_depth(message: Any, topic: str) -> np.ndarray:
    """Depth (H, W) uint16 counts, or float32 metres where the packer had quantised floats."""
    data = picture_bytes(message)
    start = data.find(_PNG, 0, 64)
    if start < 0:
        raise DatasetError(f"topic '{topic}': compressed depth holds no PNG")
    counts = cv2.imdecode(np.frombuffer(data, np.uint8, offset=start), cv2.IMREAD_UNCHANGED)
    if counts is None or counts.ndim != 2:
        raise DatasetError(f"topic '{topic}': compressed depth is damaged")
    # The header's parameters are left unset for integers, so the format must tell.
    if start < _COMPRESSED_DEPTH.size or not message.format.lower().startswith("32fc1"):
        return np.asarray(counts)
    _, a, b = _COMPRESSED_DEPTH.unpack_from(data)
    inverse = np.where(counts > 0, counts.astype(np.float32) - np.float32(b), np.inf)
    return np.asarray(np.float32(a) / inverse, np.float32)


def _rows(message: Any, dtype: np.dtype, channels: int, topic: str) -> np.ndarray:
    """Pixels (H, W) or (H, W, C) of a bare picture whose rows may be padded."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(picture_bytes(message), np.uint8)
    used = width * channels * dtype.itemsize
    if step < used or len(data) < step * (height - 1) + used or not height or not width:
        raise DatasetError(
            f"topic '{topic}': {height}x{width} pixels of {message.encoding} need rows of {used} "
            f"bytes, got {len(data)} bytes in rows of {step}"
        )
    padded = np.zeros(step * height, np.uint8)
    padded[: len(data)] = data[: step * height]
    swapped = bool(getattr(message, "is_bigendian", 0)) and dtype.itemsize > 1
    typed = np.ascontiguousarray(padded.reshape(height, step)[:, :used]).view(
        dtype.newbyteorder(">" if swapped else "<")
    )
    shaped = typed.reshape((height, width) if channels == 1 else (height, width, channels))
    return shaped.astype(dtype.newbyteorder("="), copy=False)
