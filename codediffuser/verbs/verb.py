"""What all verbs share: options that mean the same everywhere, and how progress is shown."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro
from rich.console import Console
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table

T = TypeVar("T")

NumEpisodes = Annotated[int, tyro.conf.arg(aliases=["-n"])]
"""An option for how many, with the short form `-n`."""

console = Console(stderr=True, highlight=False)
"""People read stderr; stdout carries only the result, so that scripts can."""
TOLD_EVERY_S = 30.0
"""How often a bar that is no terminal's prints a line."""
WIDEST = 400
"""A table in a file has at most so many columns."""


@dataclass(kw_only=True)
class Verb(ABC):
    """Options of every verb."""

    debug: bool = field(default=False)
    """Show the whole trace of an error, and debug messages."""

    @abstractmethod
    def run(self) -> Path | str | None:
        """Do the work; what is returned is printed last."""


def print_table(table: Table) -> None:
    """Print a table: as wide as the terminal, or as it needs to be in a pipe or file."""
    if console.is_terminal:
        console.print(table)
        return
    needed = Measurement.get(console, console.options.update(max_width=WIDEST), table).maximum
    Console(file=console.file, width=max(needed, console.width), highlight=False).print(table)


class _Bars(Progress):
    """Bars that also tell how far they are where nobody sees them move: in a file or a pipe."""

    _told_at = 0.0

    def update(self, *arguments: Any, **changes: Any) -> None:
        super().update(*arguments, **changes)
        if self.console.is_terminal or self.finished:
            return
        now = time.monotonic()
        self._told_at = self._told_at or now
        if now - self._told_at >= TOLD_EVERY_S:
            self._told_at = now
            self.console.print(self.make_tasks_table([t for t in self.tasks if not t.finished]))


def stage_bars() -> Progress:
    """Return bars with counts, times and a `note` field, on stderr."""

    # In a narrow window the note gives way; counts and times stay whole.
    def whole(width: int) -> Column:
        return Column(min_width=width, no_wrap=True)

    return _Bars(
        TextColumn("[bold]{task.description}", table_column=whole(11)),
        BarColumn(bar_width=16),
        MofNCompleteColumn(table_column=whole(9)),
        TimeElapsedColumn(table_column=whole(7)),
        TimeRemainingColumn(table_column=whole(7)),
        TextColumn("{task.fields[note]}", table_column=Column(no_wrap=True, ratio=1)),
        console=console,
    )


def track(items: Iterable[T], what: str, total: int | None) -> Iterator[T]:
    """Yield the items of a long piece of work under a progress bar on stderr."""
    with stage_bars() as progress:
        bar = progress.add_task(what, total=total, note="")
        for item in items:
            progress.update(bar, advance=1, note=getattr(item, "note", ""))
            yield item
