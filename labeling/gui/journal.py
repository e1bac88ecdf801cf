"""Every action of an operator on disk before it is called saved: an append-only JSONL per operator.

The drafts in memory are what replaying the journal gives, by the same code, so a killed server
comes back with selections and undo steps as they were. Submitted labels are elsewhere, in the
label store.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError

from codediffuser.files import fsync_folder, sha256_json
from codediffuser.labeling.gui.draft import Draft
from codediffuser.labeling.index import LABELING
from codediffuser.labeling.label import Role
from codediffuser.schema import Strict

DRAFTS = "drafts"


class Opened(Strict):
    """A tab begins, or goes on, with an episode."""

    op: Literal["open"] = "open"
    tab: str
    episode: str
    at: str
    goes_on_from: str | None = None
    """The tab whose draft it takes over; None begins anew."""
    base_revision: int = 0
    """Revision of the labels on disk that the draft starts from."""
    selection: tuple[tuple[Role, str], ...] = ()


class Chosen(Strict):
    """The selection becomes another one."""

    op: Literal["set"] = "set"
    tab: str
    episode: str
    at: str
    selection: tuple[tuple[Role, str], ...]
    prelabel: str | None = None


class Stepped(Strict):
    """Undo or redo."""

    op: Literal["undo", "redo"]
    tab: str
    episode: str
    at: str


class Based(Strict):
    """The draft now stands on a revision: it was submitted as it, or put on top of it."""

    op: Literal["base"] = "base"
    tab: str
    episode: str
    at: str
    revision: int
    submitted: bool


Record = Opened | Chosen | Stepped | Based
_RECORD: TypeAdapter[Record] = TypeAdapter(Annotated[Record, Field(discriminator="op")])


@dataclass(frozen=True, slots=True)
class Entry:
    """Where one tab stands in one episode."""

    draft: Draft
    base_revision: int
    submitted: bool = False
    """Whether the selection is the one in the label store."""


class Journal:
    """The drafts of one operator, in memory and on disk.

    Args:
        run: Run folder.
        operator: Any name; the file's name is made from it.
    """

    def __init__(self, run: Path, operator: str) -> None:
        self.path = run / LABELING / DRAFTS / f"{_file_name(operator)}.jsonl"
        self.entries: dict[tuple[str, str], Entry] = {}
        """(tab, episode) to where it stands."""
        self.last: dict[str, str] = {}
        """Episode to the tab that acted on it last, oldest action first."""
        self.dropped = 0
        """Lines that could not be read when the journal was opened."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._mend()
        for record in self._read():
            self._apply(record)
        self._lock = threading.Lock()
        self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        fsync_folder(self.path.parent)

    def write(self, record: Record) -> Entry:
        """Make a record last, then apply it; returns where the tab stands now.

        One call of the operating system writes the whole line, so two servers do not mix theirs.
        """
        with self._lock:
            os.write(self._file, record.model_dump_json().encode() + b"\n")
            os.fsync(self._file)
            return self._apply(record)

    def latest(self, episode: str) -> tuple[str, Entry] | None:
        """The tab that acted last on an episode, and where it stands."""
        tab = self.last.get(episode)
        return (tab, self.entries[tab, episode]) if tab is not None else None

    def close(self) -> None:
        """Close the file; what is written is written."""
        os.close(self._file)

    def _apply(self, record: Record) -> Entry:
        key = (record.tab, record.episode)
        entry = self.entries.get(key, Entry(draft=Draft(), base_revision=0))
        match record:
            case Opened():
                source = self.entries.get((record.goes_on_from or "", record.episode))
                entry = source or Entry(
                    draft=Draft(record.selection), base_revision=record.base_revision
                )
            case Chosen():
                draft = entry.draft.with_selection(record.selection, record.prelabel)
                entry = replace(entry, draft=draft, submitted=False)
            case Stepped():
                draft = entry.draft.undo() if record.op == "undo" else entry.draft.redo()
                entry = replace(entry, draft=draft, submitted=False)
            case Based():
                entry = replace(
                    entry, base_revision=record.revision, submitted=record.submitted
                )  # fmt: skip
        self.entries[key] = entry
        self.last.pop(record.episode, None)
        self.last[record.episode] = record.tab
        return entry

    def _mend(self) -> None:
        """End a line that a power cut left unfinished, so that the next one stands on its own."""
        if self.path.exists():
            with self.path.open("r+b") as stream:
                if stream.seek(0, os.SEEK_END) > 0:
                    stream.seek(-1, os.SEEK_END)
                    if stream.read(1) != b"\n":
                        stream.write(b"\n")

    def _read(self) -> Iterator[Record]:
        if not self.path.exists():
            return
        for line in self.path.read_bytes().splitlines():
            try:
                yield _RECORD.validate_json(line)
            except ValidationError:
                self.dropped += 1


def _file_name(operator: str) -> str:
    """A file name that no two operators share, whatever characters their names have."""
    readable = re.sub(r"[^A-Za-z0-9_-]+", "-", operator).strip("-")[:40]
    return readable if readable == operator else f"{readable}-{sha256_json(operator)[:8]}"
