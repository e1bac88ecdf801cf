"""Episodes as rosbag2 recordings, which `ros2 bag play` and every ROS tool open.

The messages of the raw log travel byte for byte; nothing is encoded again.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.errors import DatasetError
from codediffuser.files import atomic_folder

Storage = Literal["mcap", "sqlite3"]
_PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
VERSION = 9
"""Of rosbag2's metadata: Jazzy's, and the newest."""


def export_episode(episode: Episode, out: Path, *, storage: Storage = "mcap") -> Path:
    """Write one episode as a rosbag2 folder, whole or not at all.

    Args:
        episode: What to export.
        out: Folder of the recording; an older one is replaced.
        storage: Kind of file inside.

    Returns:
        The folder.

    Raises:
        DatasetError: A message is of a type that ROS 2 Humble does not know.
    """
    with atomic_folder(out) as partial:
        # The writer makes its own folder and names its file after it.
        inner = partial / out.name
        with Writer(inner, version=VERSION, storage_plugin=_PLUGINS[storage]) as writer:
            _copy_messages(episode, writer)
        for path in list(inner.iterdir()):
            path.rename(partial / path.name)
        inner.rmdir()
    return out


def export_run(run: Path, out: Path, *, storage: Storage = "mcap") -> Iterator[Path]:
    """Write every episode of a run as a rosbag2 folder named after its id."""
    for folder in list_episodes(run):
        yield export_episode(Episode.open(folder), out / folder.name, storage=storage)


def _copy_messages(episode: Episode, writer: Writer) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    connections = {}
    with episode.log_path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.topic not in connections:
                if schema is None or schema.name not in store.fielddefs:
                    raise DatasetError(f"{episode.log_path}: '{channel.topic}' has no ROS 2 type")
                qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
                connections[channel.topic] = writer.add_connection(
                    channel.topic, schema.name, typestore=store, offered_qos_profiles=qos
                )
            writer.write(connections[channel.topic], message.log_time, message.data)
