"""Several files of one recording as one: split rosbag2 folders, with or without metadata."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from codediffuser.datasets.importing.mcap_file import McapRecording
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.sqlite_file import SqliteRecording
from codediffuser.errors import DatasetError
from codediffuser.schema import load_yaml

METADATA = "metadata.yaml"
_READERS: dict[str, type[Recording]] = {".mcap": McapRecording, ".db3": SqliteRecording}


class JoinedRecording(Recording):
    """The files of one recording, one after the other.

    Args:
        path: The folder, for reports.
        parts: Its open files in the order of recording.
        packed_messages: Whether each message is packed with zstd on its own.
    """

    def __init__(
        self, path: Path, parts: Sequence[Recording], *, packed_messages: bool = False
    ) -> None:
        super().__init__(path)
        self.format = f"rosbag2 {parts[0].format.removeprefix('rosbag2 ')}"
        self._parts = list(parts)
        self._packed = packed_messages
        self.damage = [text for part in parts for text in part.damage]
        for part in parts:
            self.topics = part.topics | self.topics
        empty = np.zeros(0, np.int64)
        counts = {t: [len(p.times_ns.get(t, empty)) for p in parts] for t in self.topics}
        self._ends = {t: np.cumsum(c) for t, c in counts.items()}
        self.times_ns = {
            t: np.concatenate([p.times_ns.get(t, empty) for p in parts]) for t in self.topics
        }

    def close(self) -> None:
        """Close all parts."""
        for part in self._parts:
            part.close()

    def read(self, topic: str, index: int) -> bytes:
        """Content of one message; see `Recording.read`."""
        ends = self._ends[topic]
        number = int(np.searchsorted(ends, index, side="right"))
        before = int(ends[number - 1]) if number else 0
        data = self._parts[number].read(topic, index - before)
        if not self._packed:
            return data
        try:
            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        except zstandard.ZstdError as error:
            raise DatasetError(f"{self.path.name}: a message is damaged ({error})") from None


def open_rosbag2(folder: Path) -> JoinedRecording:
    """Open a rosbag2 folder; without metadata, as after a killed recorder, it is read all the same.

    Raises:
        DatasetError: It holds no files of a recording, or they are packed as files.
    """
    metadata = _metadata(folder)
    names = [Path(name).name for name in metadata.get("relative_file_paths", ())]
    paths = [folder / name for name in names] or _by_number(folder)
    if metadata.get("compression_mode", "").lower() == "file" or any(
        path.suffix == ".zstd" for path in paths
    ):
        raise DatasetError(
            f"{folder}: its files are packed as a whole; unpack them first (zstd -d *.zstd) and "
            f"remove {METADATA}"
        )
    missing = [path.name for path in paths if not path.is_file()]
    parts = [_READERS[path.suffix](path) for path in paths if path.is_file()]
    if not parts:
        raise DatasetError(f"{folder}: no .mcap and no .db3 file of a recording is in it")
    packed = metadata.get("compression_mode", "").lower() == "message"
    recording = JoinedRecording(folder, parts, packed_messages=packed)
    recording.damage += [f"{name} is missing" for name in missing]
    if not metadata:
        recording.damage.append(f"no {METADATA}: the recorder did not end properly")
    return recording


def is_rosbag2(folder: Path) -> bool:
    """Whether a folder is one rosbag2 recording, rather than a folder of recordings."""
    if (folder / METADATA).is_file():
        return True
    files = _by_number(folder)
    return bool(files) and all(_stem(path) == folder.name for path in files)


def _metadata(folder: Path) -> dict[str, Any]:
    path = folder / METADATA
    return dict(load_yaml(path)["rosbag2_bagfile_information"]) if path.is_file() else {}


def _by_number(folder: Path) -> list[Path]:
    """Files of recordings; `bag_10` comes after `bag_9`."""
    files = [p for p in folder.iterdir() if p.suffix in _READERS]
    return sorted(files, key=lambda p: (len(p.name), p.name))


def _stem(path: Path) -> str:
    """Name of the recording of a file: `bag` of `bag_3.db3`."""
    stem, _, number = path.stem.rpartition("_")
    return stem if number.isdigit() else path.stem
