"""MCAP files, whole or cut off: walks the records once without unpacking what has an index.

The summary at the end is not used: a recorder that was killed has written none, and the index
records behind each chunk say the same.

Source: the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from rosbags.typesys.msg import normalize_msgtype

from codediffuser.datasets.importing.recording import ChunkCache, Encoding, Recording, Topic
from codediffuser.errors import DatasetError

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
"""Start time, end time, unpacked size, unpacked CRC, length of the compression's name."""
_NO_CHUNK = -1
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
# What unpacking and parsing raise on damaged bytes.
_DAMAGED = (struct.error, ValueError, RuntimeError, zstandard.ZstdError, MemoryError, OverflowError)
_ENCODINGS: dict[str, Encoding] = {
    "cdr": "cdr", "ros1": "ros1", "protobuf": "protobuf", "json": "json",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Chunk:
    position: int
    """Of its packed data in the file."""
    packed: int
    unpacked: int
    crc: int
    compression: str


@dataclass(slots=True)
class _Places:
    """Where the messages of one topic are."""

    time: array[int] = field(default_factory=lambda: array("q"))
    chunk: array[int] = field(default_factory=lambda: array("q"))
    offset: array[int] = field(default_factory=lambda: array("q"))


class McapRecording(Recording):
    """One MCAP file.

    Raises:
        DatasetError: It is no MCAP file.
    """

    format = "mcap"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._stream = path.open("rb")
        if self._stream.read(len(MAGIC)) != MAGIC:
            self._stream.close()
            raise DatasetError(f"{path}: is no MCAP file, its first bytes are others")
        self._size = path.stat().st_size
        self._chunks: list[_Chunk] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, str] = {}
        self._places: dict[str, _Places] = {}
        self._cache = ChunkCache()
        self._zstd = zstandard.ZstdDecompressor()
        self._walk()
        self.times_ns = {t: np.array(p.time, np.int64) for t, p in self._places.items()}

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, topic: str, index: int) -> bytes:
        """Content of one message; see `Recording.read`."""
        places = self._places[topic]
        number, offset = places.chunk[index], places.offset[index]
        if number == _NO_CHUNK:
            self._stream.seek(offset)
            _, length = _RECORD.unpack(self._stream.read(_RECORD.size))
            return self._stream.read(length)[_MESSAGE.size :]
        data = self._cache.get(number, lambda: self._unpack(number))
        _, length = _RECORD.unpack_from(data, offset)
        start = offset + _RECORD.size
        return data[start + _MESSAGE.size : start + length]

    def _walk(self) -> None:
        """Note where every message is, up to the end or to the first bytes that make no sense."""
        pending: int | None = None
        """A chunk whose index records have not come yet."""
        for opcode, position, length in self._records():
            if opcode == Opcode.MESSAGE_INDEX:
                pending = self._note_index(position, length)
                continue
            if pending is not None:
                self._note_by_unpacking(pending)
                pending = None
            if opcode == Opcode.CHUNK:
                pending = self._note_chunk(position, length)
            elif opcode == Opcode.MESSAGE:
                self._note_message(self._read_at(position, _MESSAGE.size), _NO_CHUNK, position)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._note_description(opcode, self._read_at(position, length))
            elif opcode == Opcode.DATA_END:
                return
        if pending is not None:
            self._note_by_unpacking(pending)
        self.damage.append(f"{self.path.name} is cut off; what is whole before the end is used")

    def _records(self) -> Iterator[tuple[int, int, int]]:
        """Opcode, position of the content, and length of each record that is wholly there."""
        position = len(MAGIC)
        while position + _RECORD.size <= self._size:
            opcode, length = _RECORD.unpack(self._read_at(position, _RECORD.size))
            position += _RECORD.size
            if position + length > self._size or opcode == 0:
                return
            yield opcode, position, length
            position += length

    def _read_at(self, position: int, length: int) -> bytes:
        self._stream.seek(position)
        return self._stream.read(length)

    def _note_chunk(self, position: int, length: int) -> int:
        head = self._read_at(position, min(length, 64))
        _, _, unpacked, crc, name_length = _CHUNK.unpack_from(head)
        name_end = _CHUNK.size + name_length
        compression = head[_CHUNK.size : name_end].decode()
        (packed,) = struct.unpack_from("<Q", head, name_end)
        self._chunks.append(_Chunk(position + name_end + 8, packed, unpacked, crc, compression))
        return len(self._chunks) - 1

    def _note_index(self, position: int, length: int) -> int | None:
        """Take in the places of one channel's messages; returns the chunk if that is not enough."""
        number = len(self._chunks) - 1
        content = self._read_at(position, length)
        channel, size = struct.unpack_from("<HI", content)
        if channel not in self._channels:
            # The channel is described inside the chunk, for the first time.
            self._describe_from(number)
        places = self._places.get(self._channels.get(channel, ""))
        if places is None:
            return None
        entries = np.frombuffer(content, _ENTRY, size // _ENTRY.itemsize, offset=6)
        # Within a chunk, messages arrive in the order of their places.
        entries = entries[np.argsort(entries["offset"], kind="stable")]
        places.time.frombytes(entries["time"].astype("<i8").tobytes())
        places.offset.frombytes(entries["offset"].astype("<i8").tobytes())
        places.chunk.extend([number] * len(entries))
        return None

    def _describe_from(self, number: int) -> None:
        for opcode, start, length, data in self._inside(number):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._note_description(opcode, data[start : start + length])

    def _note_by_unpacking(self, number: int) -> None:
        for opcode, start, length, data in self._inside(number):
            if opcode == Opcode.MESSAGE:
                head = data[start : start + _MESSAGE.size]
                self._note_message(head, number, start)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._note_description(opcode, data[start : start + length])

    def _inside(self, number: int) -> Iterator[tuple[int, int, int, bytes]]:
        """Opcode, start, length and whole content of the records of a chunk; none when damaged."""
        try:
            data = self._cache.get(number, lambda: self._unpack(number))
        except DatasetError as error:
            self.damage.append(str(error))
            return
        position = 0
        while position + _RECORD.size <= len(data):
            opcode, length = _RECORD.unpack_from(data, position)
            yield opcode, position + _RECORD.size, length, data
            position += _RECORD.size + length

    def _note_message(self, head: bytes, chunk: int, start: int) -> None:
        channel, _, log_time, _ = _MESSAGE.unpack(head)
        places = self._places.get(self._channels.get(channel, ""))
        if places is not None:
            places.time.append(log_time)
            places.chunk.append(chunk)
            places.offset.append(start - _RECORD.size)

    def _note_description(self, opcode: int, content: bytes) -> None:
        stream = ReadDataStream(io.BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
            return
        channel = Channel.read(stream)
        encoding = _ENCODINGS.get(channel.message_encoding)
        if encoding is None or channel.id in self._channels:
            return
        schema = self._schemas.get(channel.schema_id, Schema(0, b"", "", ""))
        self._channels[channel.id] = channel.topic
        self._places.setdefault(channel.topic, _Places())
        # ROS 1 writes `sensor_msgs/Image` where ROS 2 has `sensor_msgs/msg/Image`.
        name = normalize_msgtype(schema.name) if encoding == "ros1" else schema.name
        self.topics[channel.topic] = Topic(
            channel.topic, name, encoding, schema.encoding, bytes(schema.data)
        )

    def _unpack(self, number: int) -> bytes:
        chunk = self._chunks[number]
        packed = self._read_at(chunk.position, chunk.packed)
        try:
            data = _unpack(packed, chunk, self._zstd)
            if chunk.crc and zlib.crc32(data) != chunk.crc:
                raise ValueError("checksum differs")
        except _DAMAGED as error:
            raise DatasetError(
                f"{self.path.name}: the chunk at byte {chunk.position} is damaged ({error})"
            ) from None
        return data


def _unpack(packed: bytes, chunk: _Chunk, zstd: zstandard.ZstdDecompressor) -> bytes:
    if chunk.compression == "zstd":
        return zstd.decompress(packed, max_output_size=chunk.unpacked)
    if chunk.compression == "lz4":
        return bytes(lz4.frame.decompress(packed))
    if chunk.compression == "":
        return packed
    raise ValueError(f"compression '{chunk.compression}' is not known")
