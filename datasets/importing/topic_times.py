"""The messages of one topic around one episode: when they were received, stamped, and their order.

Every message is touched once, so bytes that are damaged are known before frames are chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codediffuser.datasets.importing.config import Clock
from codediffuser.datasets.importing.decoding import Decoder
from codediffuser.datasets.importing.recording import Recording
from codediffuser.errors import DatasetError

SAME_CLOCK_NS = 1_000_000_000
"""Stamps this close to the receive times are taken for the same clock; others are shifted."""


@dataclass(frozen=True, slots=True)
class TopicTimes:
    """Readable messages of one topic in a window of time."""

    topic: str
    index: np.ndarray
    """(n,) int64 places in the recording, in the order of arrival."""
    bag_ns: np.ndarray
    """(n,) int64 receive times."""
    header_ns: np.ndarray | None
    """(n,) int64 stamps of the sender; None unless every message has one."""

    @property
    def shift_ns(self) -> int:
        """What brings the sender's clock to the bag's; 0 when they are the same."""
        if self.header_ns is None or not len(self.index):
            return 0
        shift = int(np.median(self.bag_ns - self.header_ns))
        return shift if abs(shift) > SAME_CLOCK_NS else 0

    def on(self, clock: Clock, shift_ns: int = 0) -> tuple[np.ndarray, np.ndarray, Clock]:
        """Times in ascending order with the places of their messages.

        Args:
            clock: Which times; a topic without stamps gives bag times.
            shift_ns: Between the sender's clock and the bag's, for topics without stamps.

        Returns:
            times_ns (n,) int64, index (n,) int64, and the clock that was used. Of messages with
            equal times the last to arrive comes last.
        """
        used: Clock = "header" if clock == "header" and self.header_ns is not None else "bag"
        if used == "header":
            assert self.header_ns is not None
            times = self.header_ns
        else:
            times = self.bag_ns - (shift_ns if clock == "header" else 0)
        order = np.argsort(times, kind="stable")
        return times[order], self.index[order], used


def read_times(
    recording: Recording, topic: str, start_ns: int, stop_ns: int
) -> tuple[TopicTimes, list[str]]:
    """Touch every message of a topic that was received in a window.

    Returns:
        The times, and what is damaged in words.
    """
    decoder = Decoder(recording.topics[topic])
    bag = recording.times_ns[topic]
    window = np.flatnonzero((bag >= start_ns) & (bag <= stop_ns))
    kept, stamps, damage = [], [], []
    for i in window.tolist():
        try:
            stamps.append(decoder.stamp_ns(recording.read(topic, i)))
        except DatasetError as error:
            damage.append(str(error))
            continue
        kept.append(i)
    index = np.array(kept, np.int64)
    header = None
    if kept and all(stamp is not None for stamp in stamps):
        header = np.array(stamps, np.int64)
    if damage:
        damage = [f"{len(damage)} messages of '{topic}' cannot be read: {damage[0]}"]
    return TopicTimes(topic, index, bag[index], header), damage
