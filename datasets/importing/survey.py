"""What a recording holds: topics or data sets, their types, rates and gaps."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from codediffuser.datasets.importing.array_file import ArrayFile
from codediffuser.datasets.importing.decoding import Decoder
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.sources import open_source
from codediffuser.errors import DatasetError

Role = Literal["color", "depth", "calibration", "transforms", "joints", "pose", "number", "text",
               "marker", "other"]  # fmt: skip
_COLOR_TYPES = ("CompressedImage", "CompressedVideo")
_RAW_TYPES = ("Image", "RawImage")
_POSE_TYPES = ("PoseStamped", "Pose", "PoseInFrame", "PoseWithCovarianceStamped", "Odometry",
               "TransformStamped")  # fmt: skip
_NUMBER_TYPES = ("Float32", "Float64", "Float64MultiArray", "Float32MultiArray", "Int32")
_MARKER_WORDS = ("episode", "marker", "demo", "trial", "record")
GAP_PERIODS = 3.0
"""Silence of as many periods is told as a gap."""


@dataclass(frozen=True, slots=True)
class TopicSurvey:
    """One topic of a bag, or one data set of a file of rows."""

    name: str
    type: str
    count: int
    rate_hz: float
    """From the median interval; 0 for data sets and single messages."""
    gaps: int
    longest_gap_s: float
    role: Role
    first: Any = None
    """The first message; None for data sets and what cannot be decoded."""


@dataclass(frozen=True, slots=True)
class Survey:
    """One recording."""

    path: Path
    format: str
    seconds: float
    """0 where a format has no clock."""
    episodes: int
    """1 for a bag that is not cut yet."""
    topics: tuple[TopicSurvey, ...]
    damage: tuple[str, ...]
    hz: int = 0
    """Of a file of rows; 0 for bags."""

    def of_role(self, *roles: Role) -> list[TopicSurvey]:
        """Topics with one of these roles."""
        return [topic for topic in self.topics if topic.role in roles]


def survey_source(path: Path) -> Survey:
    """Look at one recording; of a bag only the index and one message of each topic are read.

    Raises:
        DatasetError: It cannot be opened.
    """
    with closing(open_source(path)) as source:
        return _survey_rows(source) if isinstance(source, ArrayFile) else _survey_bag(source)


def _survey_bag(recording: Recording) -> Survey:
    first, last = recording.span_ns
    topics = []
    for name in sorted(recording.topics):
        times = np.sort(recording.times_ns[name])
        intervals = np.diff(times)
        intervals = intervals[intervals > 0]
        period = float(np.median(intervals)) if len(intervals) else 0.0
        gaps = intervals[intervals > GAP_PERIODS * period] if period else intervals[:0]
        message = _first_message(recording, name)
        role = _role(name, recording.topics[name].type, message)
        topics.append(
            TopicSurvey(
                name, recording.topics[name].type, len(times), 1e9 / period if period else 0.0,
                len(gaps), float(gaps.max()) / 1e9 if len(gaps) else 0.0, role, message,
            )
        )  # fmt: skip
    return Survey(
        recording.path, recording.format, (last - first) / 1e9, 1, tuple(topics),
        tuple(recording.damage),
    )  # fmt: skip


def _first_message(recording: Recording, topic: str) -> Any:
    if not len(recording.times_ns[topic]):
        return None
    try:
        return Decoder(recording.topics[topic]).decode(recording.read(topic, 0))
    except DatasetError as error:
        recording.damage.append(str(error))
        return None


def _role(name: str, type_name: str, message: Any) -> Role:
    short = type_name.replace(".", "/").rsplit("/", 1)[-1]
    if short in ("CameraInfo", "CameraCalibration"):
        return "calibration"
    if short in ("TFMessage", "tfMessage", "FrameTransform", "FrameTransforms"):
        return "transforms"
    if short in _RAW_TYPES:
        encoding = str(getattr(message, "encoding", "")).lower()
        return "depth" if encoding in ("16uc1", "mono16", "32fc1") else "color"
    if short in _COLOR_TYPES:
        words = f"{name} {getattr(message, 'format', '')}".lower()
        return "depth" if "depth" in words else "color"
    if short in ("JointState", "JointStates", "JointTrajectory"):
        return "joints"
    if short in _POSE_TYPES:
        return "pose"
    if name.endswith("_service_event") or short in ("Bool", "Empty"):
        return "marker"
    if short == "String":
        return "marker" if any(word in name.lower() for word in _MARKER_WORDS) else "text"
    return "number" if short in _NUMBER_TYPES else "other"


def _survey_rows(file: ArrayFile) -> Survey:
    columns = file.columns(file.episodes[0]) if file.episodes else {}
    topics = tuple(
        TopicSurvey(
            name, f"{column.dtype} {column.shape}", column.length, 0.0, 0, 0.0,
            _row_role(name, column.shape, column.dtype),
        )
        for name, column in sorted(columns.items())
    )  # fmt: skip
    return Survey(
        file.path, file.format, 0.0, len(file.episodes), topics, tuple(file.damage), file.hz
    )


def _row_role(name: str, shape: tuple[int, ...], dtype: np.dtype) -> Role:
    words = name.lower()
    if "mask" in words or "attention" in words or "segmentation" in words:
        return "other"
    if "depth" in words and len(shape) in (2, 3):
        return "depth"
    if len(shape) == 3 and 3 in (shape[0], shape[2]):
        return "color"
    if "image" in words and (dtype.kind in "OSV" or (dtype == np.uint8 and len(shape) == 1)):
        return "color"
    return "number" if len(shape) <= 1 and dtype.kind in "fiu" else "other"
