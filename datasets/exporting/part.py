"""Parts: one episode in the form an export needs, kept by content until the export is whole.

A part is a folder named by the hash of all that decides its content: recording, labels, options and
the code that makes it. What is there under its name need not be made again, whether an interrupted
convert or an earlier export left it.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from codediffuser.datagen.episode import load_manifest
from codediffuser.datasets.exporting.source import labels_json
from codediffuser.files import sha256_file, sha256_json, write_json
from codediffuser.labeling.store import episode_sha256

SEAL = "part.json"


def part_key(folder: Path, options: object, code: str, *, labelled: bool) -> str:
    """Hash of what decides the part of one episode.

    Args:
        folder: The episode.
        options: JSON-like: format, profile and sizes.
        code: `code_fingerprint` of the modules that make it.
        labelled: Whether labels are part of it.
    """
    manifest = load_manifest(folder)
    return sha256_json(
        {
            "log": manifest.content_hash,
            "episode": episode_sha256(manifest),
            "instruction": manifest.instruction,
            "labels": labels_json(folder) if labelled else "",
            "options": options,
            "code": code,
        }
    )


def code_fingerprint(modules: Iterable[ModuleType]) -> str:
    """Hash of source files, committed or not."""
    return sha256_json(sorted(sha256_file(Path(str(module.__file__))) for module in modules))


@dataclass(frozen=True, slots=True)
class Part:
    """One episode of an export."""

    episode_folder: Path
    key: str
    kept_in: Path

    @property
    def folder(self) -> Path:
        """Where its files are, or will be."""
        return self.kept_in / f"{self.episode_folder.name}-{self.key[:16]}"

    def is_whole(self) -> bool:
        """Whether the folder is there with the bytes that were written; removes a damaged one."""
        if not self.folder.exists():
            return False
        try:
            sealed = json.loads((self.folder / SEAL).read_text(encoding="utf-8"))
            whole = sealed == {name: sha256_file(self.folder / name) for name in sealed}
        except (OSError, ValueError, TypeError):
            whole = False
        if not whole:
            shutil.rmtree(self.folder, ignore_errors=True)
        return whole


def seal(folder: Path) -> None:
    """Record the hashes of a part's files."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    names = [path.relative_to(folder).as_posix() for path in files]
    write_json(folder / SEAL, {name: sha256_file(folder / name) for name in names})
