"""Named things that are filled in at import: tasks, policies, language models, label kinds."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from codediffuser.errors import NotRegisteredError

T = TypeVar("T")


def unknown_name(kind: str, name: str, known: list[str]) -> str:
    """Say that `name` is unknown, the closest known name, and all of them."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    return f"Unknown {kind} '{name}'.{hint} Known: {', '.join(known) or 'none'}."


class Registry(Generic[T]):
    """A mapping from name to thing that refuses a second entry under one name.

    Args:
        kind: What the entries are, for messages ("task").
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._entries: dict[str, T] = {}

    def add(self, name: str) -> Callable[[T], T]:
        """Return a decorator that enters what it decorates under `name`."""

        def enter(entry: T) -> T:
            if name in self._entries:
                raise ValueError(f"{self.kind} '{name}' is registered twice")
            self._entries[name] = entry
            return entry

        return enter

    def get(self, name: str) -> T:
        """Return the entry under `name`.

        Raises:
            NotRegisteredError: No such entry; the message gives the closest name and all names.
        """
        try:
            return self._entries[name]
        except KeyError:
            raise NotRegisteredError(unknown_name(self.kind, name, self.names())) from None

    def names(self) -> list[str]:
        """All names, sorted."""
        return sorted(self._entries)

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __len__(self) -> int:
        return len(self._entries)
