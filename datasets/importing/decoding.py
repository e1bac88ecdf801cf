"""Bytes of one message to an object with attributes, by the definition that the recording brings.

Encodings: ROS 2 CDR, ROS 1, protobuf and JSON. Every decoder also gives the sender's time stamp,
without unpacking the message where its place is known.
"""

from __future__ import annotations

import functools
import json
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)

from codediffuser.datasets.importing.recording import Topic
from codediffuser.errors import DatasetError

NANOSECONDS = 1_000_000_000
HEADER = "std_msgs/msg/Header"
TIME = "builtin_interfaces/msg/Time"
_IDL_RULE = "=" * 80 + "\n"


class Decoder:
    """Reads the messages of one topic.

    Raises:
        DatasetError: The topic's definition is missing or cannot be read.
    """

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        if topic.encoding in ("cdr", "ros1"):
            self._decode, self._stamp_of = _ros(topic)
        elif topic.encoding == "protobuf":
            self._decode, self._stamp_of = _protobuf(topic), None
        else:
            self._decode, self._stamp_of = _json, None

    def decode(self, data: bytes) -> Any:
        """Unpack one message.

        Raises:
            DatasetError: The bytes do not follow the definition.
        """
        try:
            return self._decode(data)
        except Exception as error:  # each library has its own tree of errors
            raise DatasetError(
                f"topic '{self._topic.name}': a message is no {self._topic.type} "
                f"({type(error).__name__}: {error})"
            ) from None

    def stamp_ns(self, data: bytes) -> int | None:
        """The sender's time stamp, nanoseconds; None when the type has none or it was not set."""
        if self._stamp_of is not None:
            try:
                return self._stamp_of(data) or None
            except struct.error:
                return None
        return message_stamp_ns(self.decode(data))


def message_stamp_ns(message: Any) -> int | None:
    """Time stamp of a decoded message, nanoseconds; None when it has none or it was not set."""
    transforms = getattr(message, "transforms", None)
    if transforms is not None and len(transforms):
        message = transforms[0]
    header = getattr(message, "header", None)
    stamp = getattr(header if header is not None else message, "stamp", None)
    if stamp is None:
        stamp = getattr(message, "timestamp", None)
    if stamp is None:
        return None
    seconds = _first(stamp, "sec", "seconds")
    fraction = _first(stamp, "nanosec", "nsec", "nanos")
    if seconds is None:
        return None
    return int(seconds) * NANOSECONDS + int(fraction or 0) or None


def _first(value: Any, *names: str) -> Any:
    return next((getattr(value, name) for name in names if hasattr(value, name)), None)


_Stamp = Callable[[bytes], "int | None"]


def _ros(topic: Topic) -> tuple[Callable[[bytes], Any], _Stamp | None]:
    store = _typestore(topic.type, topic.schema_encoding, topic.schema)
    if topic.type not in store.fielddefs:
        raise DatasetError(
            f"topic '{topic.name}': the recording brings no definition of {topic.type}, and ROS 2 "
            "Humble knows none; record it again with definitions, as MCAP does"
        )
    ros1 = topic.encoding == "ros1"
    read = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    fields = store.fielddefs[topic.type][1]
    first = fields[0][1][1] if fields else None
    stamp: _Stamp | None = _no_stamp
    if first == HEADER:
        stamp = _ros1_header_stamp if ros1 else _cdr_stamp
    elif first == TIME:
        stamp = _ros1_stamp if ros1 else _cdr_stamp
    elif fields and fields[0][0] == "transforms":
        stamp = None
    return (lambda data: read(data, topic.type)), stamp


@functools.lru_cache(maxsize=256)
def _typestore(type_name: str, encoding: str, schema: bytes) -> Any:
    """Types of one topic, from the recording's own definition or, without one, ROS 2 Humble's."""
    if not schema:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    text = schema.decode()
    try:
        if encoding == "ros2idl":
            for part in text.split(_IDL_RULE):
                _, _, rest = part.partition("\n") if part.startswith("IDL: ") else ("", "", part)
                if rest.strip():
                    store.register(get_types_from_idl(rest))
        else:
            store.register(get_types_from_msg(text, type_name))
    except (TypesysError, ValueError, KeyError) as error:
        raise DatasetError(f"the definition of {type_name} cannot be read: {error}") from None
    return store


def _no_stamp(data: bytes) -> None:
    return None


def _cdr_stamp(data: bytes) -> int:
    little = data[1] & 1
    seconds, fraction = struct.unpack_from("<iI" if little else ">iI", data, 4)
    return int(seconds) * NANOSECONDS + int(fraction)


def _ros1_header_stamp(data: bytes) -> int:
    _, seconds, fraction = struct.unpack_from("<III", data)
    return int(seconds) * NANOSECONDS + int(fraction)


def _ros1_stamp(data: bytes) -> int:
    seconds, fraction = struct.unpack_from("<II", data)
    return int(seconds) * NANOSECONDS + int(fraction)


def _protobuf(topic: Topic) -> Callable[[bytes], Any]:
    """Build the message class from the set of file descriptors that the MCAP file holds."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    try:
        pool = DescriptorPool()
        for file in FileDescriptorSet.FromString(topic.schema).file:
            pool.Add(file)
        message_class = GetMessageClass(pool.FindMessageTypeByName(topic.type))
    except Exception as error:  # protobuf's back ends raise different ones
        raise DatasetError(
            f"topic '{topic.name}': the definition of {topic.type} cannot be read: {error}"
        ) from None
    return lambda data: message_class.FromString(data)


def _json(data: bytes) -> Any:
    return json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
