"""All labels of a run as one JSONL file, to carry them between machines, and back.

First a line that names the schema, then one line per episode: its whole label document and the
points of every revision in it, base64 of little-endian float32.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from codediffuser.datagen.episode import list_episodes, load_manifest
from codediffuser.datagen.episode_format import EPISODES
from codediffuser.errors import CodeDiffuserError, ConfigError, LabelError
from codediffuser.files import atomic_path
from codediffuser.labeling.label_document import LabelsDocument
from codediffuser.labeling.store import (
    change_document,
    episode_sha256,
    load_arrays,
    load_document,
    points_sha256,
)
from codediffuser.schema import Document

Outcome = Literal["new", "newer", "unchanged", "older", "conflict", "error"]


class ExchangeHeader(Document):
    """First line of an exchange file (`schema: codediffuser.label_exchange/1`)."""

    KIND: ClassVar[str] = "label_exchange"
    VERSION: ClassVar[int] = 1

    episodes: int


class ExchangeLine(Document):
    """One episode of an exchange file."""

    KIND: ClassVar[str] = "label_exchange_episode"
    VERSION: ClassVar[int] = 1

    document: dict[str, Any]
    """What `labels.json` says, any version that this code reads."""
    points: dict[str, str]
    """Arrays by name: base64 of (N, 3) little-endian float32."""


@dataclass(frozen=True, slots=True)
class ImportResult:
    """What became of one line."""

    episode_id: str
    outcome: Outcome
    """`new`: there was nothing; `newer`: continues what was there; `older`: what is there continues
    it; `conflict`: both sides went on separately, and nothing was changed."""
    message: str = ""


def export_labels(run: Path, path: Path) -> int:
    """Write every label document of a run into one file; returns how many.

    Raises:
        LabelError: Some labels are damaged; the file is not written then.
    """
    documents = [(f, d) for f in list_episodes(run) if (d := load_document(f)) is not None]
    with atomic_path(path) as partial, partial.open("w", encoding="utf-8") as stream:
        stream.write(_dump(ExchangeHeader(episodes=len(documents))))
        for folder, document in documents:
            names = {entry.points_sha256 for entry in document.entries()}
            arrays = load_arrays(folder, names)
            stream.write(
                _dump(
                    ExchangeLine(
                        document=document.model_dump(mode="json", by_alias=True),
                        points={name: _encode(arrays[name]) for name in sorted(arrays)},
                    )
                )
            )
    return len(documents)


def import_labels(run: Path, path: Path) -> Iterator[ImportResult]:
    """Merge a file of labels into a run, episode by episode.

    An episode takes the side whose history continues the other's. Where both went on, it stays as
    it is and the result says so.

    Raises:
        ConfigError: The file is missing or no exchange file.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as an exchange file: {error}") from None
    header = ExchangeHeader.parse(_parse(lines[0] if lines else "", path, 1), f"{path}:1")
    if len(lines) - 1 != header.episodes:
        raise ConfigError(
            f"{path}: expected {header.episodes} episodes, found {len(lines) - 1}; export it again"
        )
    folders = {episode_sha256(load_manifest(f)): f for f in list_episodes(run)}
    for number, line in enumerate(lines[1:], start=2):
        where = f"{path}:{number}"
        parsed = ExchangeLine.parse(_parse(line, path, number), where)
        theirs = LabelsDocument.parse(parsed.document, where)
        try:
            yield _import_one(run, folders, theirs, parsed, where)
        except CodeDiffuserError as error:
            yield ImportResult(theirs.episode_id, "error", str(error))


def _import_one(
    run: Path, folders: dict[str, Path], theirs: LabelsDocument, line: ExchangeLine, where: str
) -> ImportResult:
    folder = folders.get(theirs.episode_sha256)
    if folder is None:
        raise LabelError(
            f"{where}: no episode in {run / EPISODES} has the content {theirs.episode_sha256[:12]} "
            f"of '{theirs.episode_id}'"
        )
    arrays = {name: _decode(name, text, where) for name, text in line.points.items()}
    if lacking := {entry.points_sha256 for entry in theirs.entries()} - set(arrays):
        raise LabelError(f"{where}: lacks the points {min(lacking)[:12]} that it names")
    outcome: list[Outcome] = []

    def merge(ours: LabelsDocument) -> LabelsDocument:
        outcome.append(_compare(ours, theirs))
        if outcome[0] not in ("new", "newer"):
            return ours
        return theirs.model_copy(update={"episode_id": ours.episode_id})

    change_document(folder, merge, arrays)
    return ImportResult(folder.name, outcome[0])


def _compare(ours: LabelsDocument, theirs: LabelsDocument) -> Outcome:
    if ours.model_copy(update={"episode_id": theirs.episode_id}) == theirs:
        return "unchanged"
    mine, other = tuple(ours.revisions()), tuple(theirs.revisions())
    said = (ours.flags, ours.reviews), (theirs.flags, theirs.reviews)
    if not mine and not ours.flags:
        return "new"
    if other[: len(mine)] == mine and all(_begins(a, b) for a, b in zip(*said, strict=True)):
        return "newer"
    if mine[: len(other)] == other and all(_begins(b, a) for a, b in zip(*said, strict=True)):
        return "older"
    return "conflict"


def _begins(start: tuple[Any, ...], whole: tuple[Any, ...]) -> bool:
    return whole[: len(start)] == start


def _dump(document: Document) -> str:
    raw = document.model_dump(mode="json", by_alias=True)
    ordered = {"schema": raw.pop("schema"), **raw}
    return json.dumps(ordered, separators=(",", ":"), ensure_ascii=False) + "\n"


def _parse(line: str, path: Path, number: int) -> Any:
    try:
        return json.loads(line)
    except json.JSONDecodeError as error:
        raise ConfigError(f"{path}:{number}:{error.colno}: not JSON: {error.msg}") from None


def _encode(points: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(points, dtype="<f4").tobytes()).decode()


def _decode(name: str, text: str, where: str) -> np.ndarray:
    try:
        raw = base64.b64decode(text, validate=True)
        points = np.frombuffer(raw, dtype="<f4").reshape(-1, 3)
    except (binascii.Error, ValueError) as error:
        raise LabelError(f"{where}: the points {name[:12]} are damaged: {error}") from None
    if points_sha256(points) != name:
        raise LabelError(f"{where}: the points {name[:12]} are not what they were")
    return points
