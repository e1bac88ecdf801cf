"""Phrases about a row of books: which one waits, and which slots lie beside or between others.

Books on the shelf are named by their title or, where one alone has it, by their colour. Left and
right are those of the observer, like everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np

from codediffuser.datagen.instructions.components import Arrangement, Component
from codediffuser.datagen.scene import ObjectSpec

Direction = tuple[float, float]
Side = Literal["left", "right"]


@dataclass(frozen=True, slots=True)
class Named:
    """How a book is called: by its title, or as the one book of a colour."""

    words: str
    """With article where one belongs: `DUBAI`, `the orange book`."""
    label: str | None = None
    """Its title; None for any."""
    name: str | None = None
    """Its `ObjectSpec.name`, `orange book`; None for any."""

    def find(self, books: Iterable[ObjectSpec]) -> ObjectSpec | None:
        """The one book that is meant; None when there is none, or more than one."""
        fitting = [
            book
            for book in books
            if book.label is not None
            and self.label in (None, book.label)
            and self.name in (None, book.name)
        ]
        return fitting[0] if len(fitting) == 1 else None

    def titles(self, names: Mapping[str, str]) -> set[str]:
        """Those of some titles, given with the names of their books, that the words fit."""
        return {
            title
            for title, name in names.items()
            if self.label in (None, title) and self.name in (None, name)
        }


@dataclass(frozen=True, slots=True)
class WaitingBook(Component):
    """The book on the pad, by its title or its colour."""

    called: Named

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """The one book, or nothing when it is another one, or the words fit two books."""
        book = self.called.find(scene.objects)
        return (book.id,) if book in scene.pickable and book is not None else ()


@dataclass(frozen=True, slots=True)
class OnlyWaitingBook(Component):
    """The book on the pad by where it is, if no other one lies there."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """The one book, or nothing."""
        return (scene.pickable[0].id,) if len(scene.pickable) == 1 else ()


@dataclass(frozen=True, slots=True)
class SlotBeside(Component):
    """Slots to one side of a book: the one next to it, or all as far as the shelf's end."""

    anchor: Named
    direction: Direction
    """Unit vector from the book to the slots, world x and y."""
    adjacent: bool
    """Whether only a slot between the book and its neighbour is meant."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """Ids of the free slots, sorted."""
        book = _shelved(self.anchor, scene)
        if book is None:
            return ()
        start = _along(book, self.direction)
        ahead = {p.id: _of(p.position_m, self.direction) - start for p in scene.free_places}
        found = [i for i, distance in ahead.items() if distance > 0]
        if self.adjacent:
            others = [_along(o, self.direction) - start for o in _row(scene) if o.id != book.id]
            neighbour = min((d for d in others if d > 0), default=np.inf)
            found = [i for i in found if ahead[i] < neighbour]
        return tuple(sorted(found))


@dataclass(frozen=True, slots=True)
class SlotBetween(Component):
    """All slots between two books, whichever of them is named first."""

    anchors: tuple[Named, Named]
    direction: Direction
    """Unit vector along the shelf, world x and y."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """Ids of the free slots, sorted."""
        books = [_shelved(anchor, scene) for anchor in self.anchors]
        ends = sorted(_along(book, self.direction) for book in books if book is not None)
        if len(ends) < 2:
            return ()
        inside = [
            p.id for p in scene.free_places if ends[0] < _of(p.position_m, self.direction) < ends[1]
        ]
        return tuple(sorted(inside))


def book_phrases(
    waiting: Sequence[Named], shelved: Sequence[Named], left: Direction, right: Direction
) -> Iterator[Component]:
    """Every phrase of the task, category by category: `book`, `slot`, `side`, `range`.

    Args:
        waiting: Names that books on the pad may have.
        shelved: Names that books on the shelf may have.
        left: What "left" means, world x and y.
        right: What "right" means.
    """
    yield OnlyWaitingBook("the book on the pad", "book")
    for called in waiting:
        yield WaitingBook(called.words, "book", called)
    sides: tuple[tuple[Side, Direction], ...] = (("left", left), ("right", right))
    for anchor in shelved:
        for side, direction in sides:
            words = f"right next to {anchor.words} on its {side} side"
            yield SlotBeside(words, "slot", anchor, direction, adjacent=True)
    for anchor in shelved:
        for side, direction in sides:
            words = f"to the {side} of {anchor.words}"
            yield SlotBeside(words, "side", anchor, direction, adjacent=False)
    for one, other in permutations(shelved, 2):
        words = f"between {one.words} and {other.words}"
        yield SlotBetween(words, "range", (one, other), right)


def _row(scene: Arrangement) -> list[ObjectSpec]:
    """The books on the shelf: those with a title that do not wait."""
    waiting = {o.id for o in scene.pickable}
    return [o for o in scene.objects if o.label is not None and o.id not in waiting]


def _shelved(anchor: Named, scene: Arrangement) -> ObjectSpec | None:
    """The book on the shelf that is meant; None when the one on the pad could be meant, too."""
    book = anchor.find(scene.objects)
    return book if book is not None and book not in scene.pickable else None


def _along(book: ObjectSpec, direction: Direction) -> float:
    """Where the middle of a book lies along a direction, m: a leaning book's is off its base."""
    middle = book.T_world_object @ np.array([0.0, 0.0, book.shape["height_m"] / 2, 1.0])
    return float(np.dot(middle[:2], direction))


def _of(position_m: tuple[float, float, float], direction: Direction) -> float:
    return float(np.dot(position_m[:2], direction))
