"""Which phrases about a row of books can be said of some scene at all.

Some cannot: beyond the books at the ends of a row there is no slot, and `the white book` is never
clear where a white one always stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

from codediffuser.datagen.instructions.book_components import (
    Named,
    SlotBeside,
    SlotBetween,
    WaitingBook,
)
from codediffuser.datagen.instructions.components import Component


@dataclass(frozen=True, slots=True)
class BooksOfScenes:
    """Titles that the scenes of a variant may hold; the row runs from left (-x) to right (+x)."""

    left: tuple[str, ...]
    """Books that always stand at the left end; only beyond the last of them may be a slot."""
    inner: tuple[str, ...]
    """Books that may stand between the ends, in any order."""
    right: tuple[str, ...]
    """The same as `left` at the right end."""
    waiting: tuple[str, ...]
    """Books of which one waits."""
    names: Mapping[str, str]
    """`ObjectSpec.name` of the book of every title: `orange book`."""

    def can_mean(self, called: Named, titles: tuple[str, ...]) -> set[str]:
        """Those of some titles that a name can single out: no book of the ends has it, too."""
        always = called.titles({title: self.names[title] for title in (*self.left, *self.right)})
        fitting = called.titles({title: self.names[title] for title in titles})
        return {title for title in fitting if always <= {title}}


def can_be_said(phrase: Component, books: BooksOfScenes) -> bool:
    """Whether there can be a scene in which a phrase names something."""
    shelved = (*books.left, *books.inner, *books.right)
    if isinstance(phrase, WaitingBook):
        return bool(books.can_mean(phrase.called, books.waiting))
    if isinstance(phrase, SlotBeside):
        rightward = phrase.direction[0] > 0
        without = set(books.right if rightward else books.left)
        if phrase.adjacent:
            without.update(books.left[:-1] if rightward else books.right[1:])
        return bool(books.can_mean(phrase.anchor, shelved) - without)
    if isinstance(phrase, SlotBetween):
        pairs = product(*(books.can_mean(anchor, shelved) for anchor in phrase.anchors))
        return any(
            one != other and not any({one, other} <= set(end) for end in (books.left, books.right))
            for one, other in pairs
        )
    return True
