"""Depth and masks as text columns, and exact statistics of pictures.

Depth is a 16-bit PNG in base64. A column of text passes every LeRobot tool unharmed, costs nothing
when it is not asked for, and no stock policy takes it for a colour camera, as it would take any
column of pictures.
"""

from __future__ import annotations

import base64
import binascii

import cv2
import numpy as np

from codediffuser.datasets.stats import QUANTILES, Stats
from codediffuser.errors import DatasetError, ShapeError

PREFIX = "data:image/png;base64,"
# Run lengths suit depth, as differences to the left, and masks: smaller than with the default
# strategy, and much faster than trying every filter on every row.
_RUN_LENGTHS = [
    cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE,
]  # fmt: skip
_PNG = {
    np.dtype(np.uint8): [*_RUN_LENGTHS, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE],
    np.dtype(np.uint16): [*_RUN_LENGTHS, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB],
}


def png_text(picture: np.ndarray) -> str:
    """A picture without loss as a data URL.

    Args:
        picture: (H, W) uint8 or uint16.
    """
    if picture.ndim != 2 or picture.dtype not in _PNG:
        raise ShapeError(f"expected (H, W) uint8 or uint16, got {picture.shape} {picture.dtype}")
    _, data = cv2.imencode(".png", picture, _PNG[picture.dtype])
    return PREFIX + base64.b64encode(data.tobytes()).decode("ascii")


def picture_of(text: str) -> np.ndarray:
    """What `png_text` was given: (H, W) uint8 or uint16.

    Raises:
        DatasetError: The text is no such picture.
    """
    try:
        data = base64.b64decode(text.removeprefix(PREFIX), validate=True)
    except binascii.Error as error:
        raise DatasetError(f"not a picture in base64: {error}: {text[:40]!r}") from None
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if picture is None:
        raise DatasetError(f"not a PNG picture in base64: {text[:40]!r}")
    return np.asarray(picture)


def mask_bits(masks: np.ndarray) -> np.ndarray:
    """(R, H, W) bool to (H, W) uint8, bit r for role r: 1 pick, 2 place, 3 both."""
    bits = np.zeros(masks.shape[1:], dtype=np.uint8)
    for role, mask in enumerate(masks):
        bits |= mask.view(np.uint8) << role
    return bits


def masks_of_bits(bits: np.ndarray, roles: int = 2) -> np.ndarray:
    """What `mask_bits` was given: (R, H, W) bool."""
    return np.stack([(bits >> role) & 1 for role in range(roles)]).astype(bool)


class PixelStats:
    """Counts every value of every pixel of a camera, so that nothing is rounded or overflows."""

    def __init__(self) -> None:
        self.counts = np.zeros((3, 256), dtype=np.int64)
        self.frames = 0

    def add(self, rgb: np.ndarray) -> None:
        """Count one picture, (H, W, 3) uint8."""
        for channel in range(3):
            histogram = cv2.calcHist([rgb], [channel], None, [256], [0, 256])
            self.counts[channel] += histogram[:, 0].astype(np.int64)
        self.frames += 1

    def stats(self) -> Stats:
        """Statistics in LeRobot's form for pictures: (3, 1, 1) each, of values in [0, 1]."""
        return pixel_stats(self.counts, self.frames)


def pixel_stats(counts: np.ndarray, frames: int) -> Stats:
    """Exact statistics from how often each channel had each value.

    Args:
        counts: (3, 256) int64, at least one in each channel. Counts of several episodes add up to
            those of all.
        frames: Pictures counted.
    """
    values = np.arange(256) / 255.0
    total = counts.sum(axis=1, keepdims=True)
    mean = counts @ values / total[:, 0]
    variance = (counts * (values - mean[:, None]) ** 2).sum(axis=1) / total[:, 0]
    seen = counts > 0
    stats = {
        "min": values[seen.argmax(axis=1)],
        "max": values[255 - seen[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(variance),
    }
    reached = counts.cumsum(axis=1) / total
    for name, share in QUANTILES.items():
        stats[name] = values[(reached >= share).argmax(axis=1)]
    shaped = {name: value.reshape(3, 1, 1) for name, value in stats.items()}
    return {**shaped, "count": np.array([frames], dtype=np.int64)}
