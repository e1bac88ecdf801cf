"""What lies at a path: one recording or a folder of several, and of which kind."""

from __future__ import annotations

from pathlib import Path

from codediffuser.datasets.importing.array_file import ArrayFile
from codediffuser.datasets.importing.array_formats import ReplayBufferFile, open_hdf5
from codediffuser.datasets.importing.bag1_file import Bag1Recording
from codediffuser.datasets.importing.joined import is_rosbag2, open_rosbag2
from codediffuser.datasets.importing.mcap_file import McapRecording
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.sqlite_file import SqliteRecording
from codediffuser.errors import DatasetError

_FILES = (".mcap", ".db3", ".bag", ".hdf5", ".h5")
KNOWN = "*.mcap, rosbag2 folders, *.db3, *.bag, *.hdf5, *.h5, *.zarr, *.zarr.zip"


def find_sources(path: Path) -> list[Path]:
    """The recordings at a path, sorted by name; numbers in names count as numbers.

    Raises:
        DatasetError: Nothing is there that can be imported.
    """
    if not path.exists():
        raise DatasetError(f"{path}: no such file or folder; expected {KNOWN}")
    found = [path] if _is_source(path) else []
    if not found and path.is_dir():
        found = sorted((p for p in path.iterdir() if _is_source(p)), key=_natural)
    if not found:
        raise DatasetError(f"{path}: nothing to import here; expected {KNOWN}")
    return found


def open_source(path: Path) -> Recording | ArrayFile:
    """Open one recording of any kind.

    Raises:
        DatasetError: It is damaged from the start, or of no known kind.
    """
    if path.name.endswith((".zarr", ".zarr.zip")) or (path / ".zgroup").is_file():
        return ReplayBufferFile(path)
    if path.is_dir():
        return open_rosbag2(path)
    if path.suffix in (".hdf5", ".h5"):
        return open_hdf5(path)
    if path.suffix == ".bag":
        return Bag1Recording(path)
    if path.suffix == ".db3":
        return SqliteRecording(path)
    if path.suffix == ".mcap":
        return McapRecording(path)
    raise DatasetError(f"{path}: is of no known kind; expected {KNOWN}")


def _is_source(path: Path) -> bool:
    if path.name.startswith("."):
        return False
    if path.is_file():
        return path.suffix in _FILES or path.name.endswith(".zarr.zip")
    return path.suffix == ".zarr" or (path / ".zgroup").is_file() or is_rosbag2(path)


def _natural(path: Path) -> tuple[tuple[int, int | str], ...]:
    """Sorts `bag_10` after `bag_9`."""
    words, word = [], ""
    for letter in path.name:
        if word and letter.isdigit() != word[-1].isdigit():
            words.append(word)
            word = ""
        word += letter
    words.append(word)
    return tuple((0, int(w)) if w.isdigit() else (1, w) for w in words)
