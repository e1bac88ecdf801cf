"""Reads the transforms and the calibration of a bag."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from codediffuser.datasets.importing.config import Clock, ImportConfig
from codediffuser.datasets.importing.decoding import Decoder, message_stamp_ns
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.transforms import TransformTree
from codediffuser.datasets.importing.values import Calibration, calibration_of, transforms_of
from codediffuser.errors import DatasetError

_FOREVER = int(np.iinfo(np.int64).max)
_TRANSFORM_TYPES = ("TFMessage", "tfMessage", "FrameTransform", "FrameTransforms")


def transform_topics(recording: Recording) -> tuple[list[str], list[str]]:
    """Topics of static and of moving transforms."""
    topics = [t.name for t in recording.topics.values() if t.type.split("/")[-1].split(".")[-1]
              in _TRANSFORM_TYPES]  # fmt: skip
    static = [name for name in topics if name.endswith("static")]
    return static, [name for name in topics if name not in static]


def read_tree(
    recording: Recording, start_ns: int, stop_ns: int, clock: Clock, damage: list[str]
) -> TransformTree:
    """The transform tree of one window of time; static transforms come from the whole recording.

    What cannot be read is told in `damage`.
    """
    static_topics, moving_topics = transform_topics(recording)
    static = [
        (parent, child, T)
        for name in static_topics
        for _, found in _messages(recording, name, 0, _FOREVER, damage)
        for parent, child, T, _ in transforms_of(found)
    ]
    moving = []
    for name in moving_topics:
        for bag_ns, message in _messages(recording, name, start_ns, stop_ns, damage):
            for parent, child, T, item in transforms_of(message):
                stamp = message_stamp_ns(item) if clock == "header" else None
                moving.append((parent, child, bag_ns if stamp is None else stamp, T))
    return TransformTree(static, moving)


def tree_cameras(config: ImportConfig) -> Iterator[tuple[str, int]]:
    """Frame and greatest age of every camera whose pose is looked up for every frame."""
    for camera in config.cameras.values():
        if camera.moving and camera.frame is not None:
            yield camera.frame, round((camera.max_age_s or config.sync.max_age_s) * 1e9)


def read_calibration(recording: Recording, topic: str, start_ns: int, where: str) -> Calibration:
    """The latest calibration at a moment, or else the first after it.

    Calibration is the same before and after, so one that comes late is no look ahead.

    Raises:
        DatasetError: There is no such topic, no message, or no calibration in it.
    """
    recording.topic(topic, where)
    times = recording.times_ns[topic]
    if not len(times):
        raise DatasetError(f"{where}: no message on the topic '{topic}'")
    before = np.flatnonzero(times <= start_ns)
    i = int(before[np.argmax(times[before])]) if len(before) else int(np.argmin(times))
    message = Decoder(recording.topics[topic]).decode(recording.read(topic, i))
    return calibration_of(message, topic)


def _messages(
    recording: Recording, topic: str, start_ns: int, stop_ns: int, damage: list[str]
) -> Iterator[tuple[int, object]]:
    """Bag time and decoded message of those in a window that can be read."""
    decoder, times = Decoder(recording.topics[topic]), recording.times_ns[topic]
    for i in np.flatnonzero((times >= start_ns) & (times <= stop_ns)).tolist():
        try:
            yield int(times[i]), decoder.decode(recording.read(topic, i))
        except DatasetError as error:
            damage.append(str(error))
