"""ROS 1 bags, whole or cut off: walks the chunks, as `rosbag reindex` does.

Records are parsed by `rosbags`; its reader itself refuses a bag without its final index.

Source: the bag format 2.0, http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import io
import struct
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import numpy as np
from rosbags.rosbag1.reader import Header, ReaderError, RecordType
from rosbags.typesys.msg import normalize_msgtype

from codediffuser.datasets.importing.recording import ChunkCache, Recording, Topic
from codediffuser.errors import DatasetError

MAGIC = b"#ROSBAG V2.0\n"
_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    "none": bytes, "bz2": bz2.decompress, "lz4": lz4.frame.decompress,
}  # fmt: skip
_DAMAGED = (ReaderError, struct.error, ValueError, RuntimeError, OSError, KeyError)


class Bag1Recording(Recording):
    """One `.bag` file of version 2.0.

    Raises:
        DatasetError: It is no such bag.
    """

    format = "rosbag1"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._stream = path.open("rb")
        if self._stream.read(len(MAGIC)) != MAGIC:
            self._stream.close()
            raise DatasetError(f"{path}: is no ROS 1 bag of version 2.0")
        self._chunks: list[tuple[int, int, str]] = []
        """Position and size of the packed data, compression."""
        self._topic_by_id: dict[int, str] = {}
        self._time: dict[str, array[int]] = {}
        self._chunk: dict[str, array[int]] = {}
        self._offset: dict[str, array[int]] = {}
        self._cache = ChunkCache()
        self._walk(path.stat().st_size)
        self.times_ns = {name: np.array(t, np.int64) for name, t in self._time.items()}

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, topic: str, index: int) -> bytes:
        """Content of one message; see `Recording.read`."""
        data = self._unpacked(self._chunk[topic][index])
        stream = io.BytesIO(data)
        stream.seek(self._offset[topic][index])
        try:
            Header.read(stream, RecordType.MSGDATA)
            return _content(stream)
        except _DAMAGED as error:
            raise DatasetError(f"{self.path.name}: a message is damaged ({error})") from None

    def _walk(self, size: int) -> None:
        position, whole = len(MAGIC), False
        while position < size:
            self._stream.seek(position)
            try:
                header = Header.read(self._stream)
                (length,) = struct.unpack("<I", self._stream.read(4))
                start = self._stream.tell()
                if start + length > size:
                    break
                kind = header.get_uint8("op")
                if kind == RecordType.CHUNK_INFO:
                    whole = True
                    break
                self._take(kind, header, start, length)
            except _DAMAGED:
                break
            position = start + length
        if not whole:
            self.damage.append(f"{self.path.name} is cut off; what is whole before the end is used")

    def _take(self, kind: int, header: Header, start: int, length: int) -> None:
        if kind == RecordType.CHUNK:
            self._chunks.append((start, length, header.get_string("compression")))
            self._index_chunk(len(self._chunks) - 1)
        elif kind == RecordType.CONNECTION:
            self._connect(header, io.BytesIO(self._stream.read(length)))

    def _index_chunk(self, number: int) -> None:
        """Note the messages of a chunk, in the order in which they came."""
        try:
            data = self._unpacked(number)
        except DatasetError as error:
            self.damage.append(str(error))
            return
        stream = io.BytesIO(data)
        while (offset := stream.tell()) < len(data):
            header = Header.read(stream)
            kind = header.get_uint8("op")
            if kind == RecordType.CONNECTION:
                self._connect(header, io.BytesIO(_content(stream)))
                continue
            (length,) = struct.unpack("<I", stream.read(4))
            stream.seek(length, io.SEEK_CUR)
            name = self._topic_by_id[header.get_uint32("conn")]
            self._time[name].append(header.get_time("time"))
            self._chunk[name].append(number)
            self._offset[name].append(offset)

    def _connect(self, header: Header, content: BinaryIO) -> None:
        """Take in a connection: its content is a second header, with type and definition."""
        number, name = header.get_uint32("conn"), header.get_string("topic")
        if number in self._topic_by_id:
            return
        raw = content.read()
        fields = Header.read(io.BytesIO(struct.pack("<I", len(raw)) + raw))
        self._topic_by_id[number] = name
        for table in (self._time, self._chunk, self._offset):
            table.setdefault(name, array("q"))
        type_name = normalize_msgtype(fields.get_string("type"))
        self.topics[name] = Topic(name, type_name, "ros1", "ros1msg", fields["message_definition"])

    def _unpacked(self, number: int) -> bytes:
        start, length, compression = self._chunks[number]

        def unpack() -> bytes:
            self._stream.seek(start)
            try:
                return _UNPACK[compression](self._stream.read(length))
            except _DAMAGED as error:
                raise DatasetError(
                    f"{self.path.name}: the chunk at byte {start} is damaged ({error})"
                ) from None

        return self._cache.get(number, unpack)


def _content(stream: BinaryIO) -> bytes:
    (length,) = struct.unpack("<I", stream.read(4))
    return stream.read(length)
