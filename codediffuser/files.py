"""Files and folders that are whole or absent: write beside, flush, then rename."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

TEMPORARY_PREFIX = ".partial-"
RETIRED_PREFIX = ".retired-"
"""Begins the name of a folder that is just being replaced."""


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


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a path beside `path` to write to; it takes the place of `path` when the block succeeds.

    Works for a file. The last suffix is kept, since many writers choose a format by it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}")
    try:
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
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        yield partial
        for file in sorted(partial.rglob("*")):
            if file.is_file():
                with file.open("rb") as stream:
                    os.fsync(stream.fileno())
        if path.exists():
            # Killed between the two renames, the old folder comes back by `remove_partials`.
            retired = path.with_name(f"{RETIRED_PREFIX}{os.getpid()}-{path.name}")
            os.replace(path, retired)
            os.replace(partial, path)
            shutil.rmtree(retired, ignore_errors=True)
        else:
            os.replace(partial, path)
        fsync_folder(path.parent)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def remove_partials(folder: Path) -> list[str]:
    """Delete what killed processes left in `folder`; processes still alive keep theirs.

    A folder that was being replaced, and whose successor did not arrive, is put back.

    Returns:
        Names of what was removed, sorted.
    """
    for path, name in _orphans(folder, RETIRED_PREFIX):
        if (folder / name).exists():
            shutil.rmtree(path, ignore_errors=True)
        else:
            os.replace(path, folder / name)
    removed = []
    for path, _ in _orphans(folder, TEMPORARY_PREFIX):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        removed.append(path.name)
    return removed


def _orphans(folder: Path, prefix: str) -> Iterator[tuple[Path, str]]:
    """Yield `PREFIX<process id>-<name>` entries that no other living process owns, and the name."""
    for path in sorted(folder.glob(f"{prefix}*")):
        owner, _, name = path.name.removeprefix(prefix).partition("-")
        if owner.isdigit() and int(owner) != os.getpid() and _alive(int(owner)):
            continue
        yield path, name


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
