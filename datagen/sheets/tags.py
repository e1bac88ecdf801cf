"""ArUco tags beside a pad: which four a pad has, and where they lie.

Every tag belongs to one corner of one pad and says so by its number alone: `4 * code + corner`,
corner 0 front left, 1 front right, 2 back right, 3 back left. The four codes of a pad, 0 to 249,
are bytes of a SHA-256 of its task, variant, name and sizes. So a pad that was printed from other
numbers has other tags and is recognised as another one, with no table to keep.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.task import Pad

DICTIONARY = "DICT_5X5_1000"
CODES = 250
"""Codes per corner: the dictionary has a thousand tags."""
MODULES = 7
"""Squares along a tag's side: five bits and the black border."""
LARGEST_TAG_M = 0.030
GAP_M = 0.010
"""White between pad and tag, which a tag is found by; the pad's numbers stand in its inner half."""
OUTER_GAP_M = 0.005
"""White between a tag and the sheet's edge."""

CORNERS = ("front left", "front right", "back right", "back left")


@dataclass(frozen=True, slots=True)
class Tag:
    """One printed tag, upright for somebody at the robot."""

    number: int
    """Id in the dictionary."""
    low_m: tuple[float, float]
    """Its front left corner, world x and y."""
    size_m: float

    def corners_m(self) -> np.ndarray:
        """(4, 2) float64 world corners in OpenCV's order: back left, then clockwise from above."""
        (x, y), size = self.low_m, self.size_m
        return np.array([[x, y + size], [x + size, y + size], [x + size, y], [x, y]])


@dataclass(frozen=True, slots=True)
class PadSheet:
    """A pad with its tags, as it is printed."""

    title: str
    """`<task> · <variant> · <pad>`."""
    pad: Pad
    tags: tuple[Tag, ...]
    """In the order of `CORNERS`."""

    @property
    def low_m(self) -> tuple[float, float]:
        """Front left corner of the sheet of paper, world x and y."""
        strip = GAP_M + self.tags[0].size_m + OUTER_GAP_M
        return (self.pad.low_m[0] - strip, self.pad.low_m[1] - GAP_M)

    @property
    def high_m(self) -> tuple[float, float]:
        """Back right corner of the sheet of paper."""
        strip = GAP_M + self.tags[0].size_m + OUTER_GAP_M
        return (self.pad.high_m[0] + strip, self.pad.high_m[1] + OUTER_GAP_M)


def pad_sheets(task_name: str, variant: str, pads: Sequence[Pad]) -> tuple[PadSheet, ...]:
    """Give every pad of a variant its tags; no two pads of it share one.

    The tags stand left and right of the pad, flush with its front and back edges, so that neither
    objects on it nor what stands behind it hide them.
    """
    sheets: list[PadSheet] = []
    taken: set[int] = set()
    for pad in pads:
        numbers = _numbers(task_name, variant, pad, taken)
        taken.update(numbers)
        title = f"{task_name} · {variant} · {pad.name}"
        sheets.append(PadSheet(title, pad, _beside(pad, numbers)))
    return tuple(sheets)


def _numbers(task_name: str, variant: str, pad: Pad, taken: set[int]) -> tuple[int, ...]:
    tenths_mm = [round(10_000 * v) for v in (*pad.low_m, *pad.high_m, pad.cross_spacing_m)]
    salt = 0
    while True:
        text = f"{task_name}/{variant}/{pad.name}/{tenths_mm}/{salt}"
        digest = hashlib.sha256(text.encode()).digest()
        codes = [int.from_bytes(digest[2 * i : 2 * i + 2]) % CODES for i in range(4)]
        numbers = tuple(4 * code + corner for corner, code in enumerate(codes))
        if taken.isdisjoint(numbers):
            return numbers
        salt += 1


def _beside(pad: Pad, numbers: tuple[int, ...]) -> tuple[Tag, ...]:
    # Two tags and a gap must fit along the pad.
    depth = pad.high_m[1] - pad.low_m[1]
    size = min(LARGEST_TAG_M, (depth - GAP_M) / 2)
    left, right = pad.low_m[0] - GAP_M - size, pad.high_m[0] + GAP_M
    front, back = pad.low_m[1], pad.high_m[1] - size
    places = ((left, front), (right, front), (right, back), (left, back))
    return tuple(Tag(n, at, size) for n, at in zip(numbers, places, strict=True))


def tag_modules(number: int) -> np.ndarray:
    """(7, 7) bool, True where a tag is black, row 0 at the back."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, MODULES)) == 0
