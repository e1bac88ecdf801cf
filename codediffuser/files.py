"""Files and folders that are whole or absent: write beside, flush, then rename."""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
import json
import os
import platform
import shutil
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from codediffuser.errors import StorageError

TEMPORARY_PREFIX = ".partial-"
RETIRED_PREFIX = ".retired-"
"""Begins the name of a folder that is just being replaced."""

FOREIGN_AGE_S = 86_400.0
"""What another machine left half-written is taken for abandoned after so long without a change."""


def cache_folder() -> Path:
    """Where derived, disposable files live: `$CODEDIFFUSER_CACHE`, else the user's cache folder.

    The user's cache folder is `$XDG_CACHE_HOME/codediffuser`, or `~/.cache/codediffuser`. Nothing
    is created.
    """
    if own := os.environ.get("CODEDIFFUSER_CACHE"):
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "codediffuser"


def sha256_file(path: Path) -> str:
    """Hex SHA-256 of a file's bytes."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def sha256_json(value: Any) -> str:
    """Hex SHA-256 of a JSON-like value, independent of key order."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def fsync_folder(path: Path) -> None:
    """Make a rename inside `path` last through a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def partial_path(path: Path, prefix: str = TEMPORARY_PREFIX) -> Path:
    """Name beside `path` that says which process of which machine writes it."""
    return path.with_name(f"{prefix}{os.getpid()}@{_machine()}-{path.name}")


@functools.cache
def _machine() -> str:
    """Short name of this machine: run folders may be shared, and process ids repeat elsewhere."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


@contextlib.contextmanager
def naming_full_disk(path: Path) -> Iterator[None]:
    """Turn "no space left" inside the block into one `StorageError` that names `path`."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise StorageError(
            f"{path}: {os.strerror(error.errno).lower()}; make room on that disk or choose another "
            "folder, then run the same command again: what is written is whole"
        ) from None


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a path beside `path` to write to; it takes the place of `path` when the block succeeds.

    Works for a file. The last suffix is kept, since many writers choose a format by it.

    Raises:
        StorageError: The disk is full.
    """
    partial = partial_path(path)
    try:
        with naming_full_disk(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield partial
            with partial.open("rb") as stream:
                os.fsync(stream.fileno())
            os.replace(partial, path)
            fsync_folder(path.parent)
    finally:
        partial.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    with atomic_path(path) as partial:
        partial.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file whole or not at all."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write indented JSON whole or not at all."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False) + "\n")


@contextlib.contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder beside `path`; it is renamed to `path` when the block succeeds.

    An older folder at `path` is replaced. A folder left by a killed process carries
    `TEMPORARY_PREFIX` and is removed by `remove_partials`.

    Raises:
        StorageError: The disk is full.
    """
    partial = partial_path(path)
    try:
        with naming_full_disk(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
            yield partial
            for file in sorted(partial.rglob("*")):
                if file.is_file():
                    with file.open("rb") as stream:
                        os.fsync(stream.fileno())
            _take_place(partial, path)
            fsync_folder(path.parent)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _take_place(partial: Path, path: Path) -> None:
    """Rename a folder to `path`, in place of one that may be there."""
    if not path.exists():
        os.replace(partial, path)
        return
    # Killed between the two renames, the old folder comes back by `remove_partials`.
    retired = partial_path(path, RETIRED_PREFIX)
    os.replace(path, retired)
    os.replace(partial, path)
    shutil.rmtree(retired, ignore_errors=True)


def remove_partials(folder: Path, names: Collection[str] = ()) -> list[str]:
    """Delete what killed processes left in `folder`; processes still alive keep theirs.

    A folder that was being replaced, and whose successor did not arrive, is put back.

    Args:
        folder: Where `atomic_path` and `atomic_folder` wrote.
        names: Look only at these files and folders, which nobody may be writing now: what is left
            of them is removed even when another machine made it. Empty for all.

    Returns:
        Names of what was removed, sorted.
    """
    for path, name in _orphans(folder, RETIRED_PREFIX, names):
        if (folder / name).exists():
            shutil.rmtree(path, ignore_errors=True)
        else:
            os.replace(path, folder / name)
    removed = []
    for path, _ in _orphans(folder, TEMPORARY_PREFIX, names):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        removed.append(path.name)
    return removed


def _orphans(folder: Path, prefix: str, names: Collection[str]) -> Iterator[tuple[Path, str]]:
    """Yield `PREFIX<process>[@<machine>]-<name>` entries that no process writes, and the name."""
    for path in sorted(folder.glob(f"{prefix}*")):
        owner, _, name = path.name.removeprefix(prefix).partition("-")
        if name in names if names else not _may_be_written(path, owner):
            yield path, name


def _may_be_written(path: Path, owner: str) -> bool:
    """Whether the process that a partial file names may still be at work on it."""
    pid, _, machine = owner.partition("@")
    if machine and machine != _machine():
        with contextlib.suppress(FileNotFoundError):
            return time.time() - path.stat().st_mtime < FOREIGN_AGE_S
        return False
    return pid.isdigit() and int(pid) != os.getpid() and _alive(int(pid))


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
