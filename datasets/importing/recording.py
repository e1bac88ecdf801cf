"""One interface to bags of every kind: topics, arrival times, and single messages by number."""

from __future__ import annotations

import abc
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from codediffuser.errors import DatasetError

Encoding = Literal["cdr", "ros1", "protobuf", "json"]

CACHE_BYTES = 64 << 20
"""Unpacked chunks that a recording keeps; frames of several topics share them."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic and how its messages are to be read."""

    name: str
    type: str
    """Full name: `sensor_msgs/msg/Image`, `foxglove.CompressedImage`."""
    encoding: Encoding
    schema_encoding: str
    """`ros2msg`, `ros2idl`, `ros1msg`, `protobuf`, `jsonschema`, or empty for none."""
    schema: bytes
    """The definition that the recording brings; empty when it brings none."""


class Recording(abc.ABC):
    """A bag that is open for reading; `contextlib.closing` closes it.

    A subclass fills `topics`, `times_ns` and `damage` when it is built.
    """

    format: str
    """Name for reports."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.times_ns: dict[str, np.ndarray] = {}
        """(n,) int64 receive times of a topic's messages, in the order of their arrival."""
        self.damage: list[str] = []
        """What could not be read, in words."""

    @abc.abstractmethod
    def read(self, topic: str, index: int) -> bytes:
        """Content of one message, by its place in `times_ns`.

        Raises:
            DatasetError: Its bytes are damaged.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """Close all files."""

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of the first and of the last message; zeros for an empty recording."""
        known = [t for t in self.times_ns.values() if len(t)]
        if not known:
            return 0, 0
        return min(int(t.min()) for t in known), max(int(t.max()) for t in known)

    def topic(self, name: str, where: str) -> Topic:
        """A topic by name.

        Args:
            name: The topic.
            where: The entry of the configuration that asks for it, for the message.

        Raises:
            DatasetError: The recording has no such topic.
        """
        if name not in self.topics:
            raise DatasetError(
                f"{self.path}: {where} asks for the topic '{name}', which is not recorded; topics: "
                f"{', '.join(sorted(self.topics)) or 'none'}"
            )
        return self.topics[name]


class ChunkCache:
    """The chunks that were unpacked last, up to a number of bytes."""

    def __init__(self, limit_bytes: int = CACHE_BYTES) -> None:
        self._limit = limit_bytes
        self._held = 0
        self._chunks: OrderedDict[Hashable, bytes] = OrderedDict()

    def get(self, key: Hashable, unpack: Callable[[], bytes]) -> bytes:
        """The chunk of a key, unpacked now unless it is held."""
        if key in self._chunks:
            self._chunks.move_to_end(key)
            return self._chunks[key]
        chunk = unpack()
        self._chunks[key] = chunk
        self._held += len(chunk)
        while self._held > self._limit and len(self._chunks) > 1:
            _, old = self._chunks.popitem(last=False)
            self._held -= len(old)
        return chunk
