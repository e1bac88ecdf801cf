"""What may follow the head of a noun phrase.

    tail = on/in/of the <side> row/column | on the <side> [side] [of the table/crate]
         | in/of the crate | outside the crate | on the table
         | <distance> [to/from <reference>] | <relation> | <title> | that is ...

A tail is taken only where it can say something of the head; else it belongs to the sentence, as in
`put the battery | in the left column`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from codediffuser.labeling.language.lexicon import DISTANCES, SIDES, Kind
from codediffuser.labeling.language.noun_phrase import HEADS, STARTS, Phrase

if TYPE_CHECKING:
    from codediffuser.labeling.language.phrases import PhraseReader


class TailReader:
    """Reads tails from the tokens of one instruction.

    Args:
        phrases: Reads the phrases within them.
    """

    def __init__(self, phrases: PhraseReader) -> None:
        self._phrases = phrases
        self._words = phrases.lexicon.vocabulary

    def read(self, phrase: Phrase, at: int) -> int:
        """Take every tail from a position on that says something of the head; where they end."""
        while True:
            end = self._tail(phrase, self._skip_relative(at))
            if end is None:
                return at
            at = end

    def _skip_relative(self, at: int) -> int:
        """Pass `that is`, `which are`, `left` (outside), when more of the phrase follows."""
        if self._phrases.word(at) == "left" and self._phrases.kind(at + 1) in (
            Kind.OUTSIDE,
            Kind.INTO,
        ):
            return at + 1
        if (
            self._phrases.word(at) in ("that", "which", "who")
            and self._phrases.kind(at + 1) is Kind.BE
        ):
            return at + 2
        return at

    def _tail(self, phrase: Phrase, at: int) -> int | None:
        """Read one tail; None when what stands here does not belong to the phrase."""
        kind = self._phrases.kind(at)
        if (relation := self._phrases.relations.read(at)) is not None:
            # A thing that is to be put beside another is not beside it yet.
            if not phrase.is_place or phrase.head != "thing":
                return None
            phrase.relation, end = relation
            return end
        if kind is Kind.TITLE and phrase.head == "thing" and not phrase.is_place:
            phrase.looks.append(self._phrases.word(at))  # "the book COMET"
            return at + 1
        if kind is Kind.OUTSIDE:
            return self._outside(at + 1)
        if kind is Kind.DISTANCE and not phrase.chooses:
            return self._distance(phrase, at)
        if kind in (Kind.INTO, Kind.OF) and self._phrases.kind(at + 1) in STARTS:
            inner, preposition = self._phrases.read(at + 1, phrase.category), self._phrases.word(at)
            measured = phrase.distance is not None and phrase.reference is None
            # "the nearest battery to the crate" says rather where the battery goes.
            unclear = preposition == "to" and inner.head == "container"
            measured = measured and preposition in ("to", "from") and not unclear
            if measured and self._refer(phrase, inner):
                return inner.end
            return self._attach(phrase, inner, preposition)
        if kind is Kind.SIDE and phrase.head == "region":
            inner = self._phrases.read(at, self._words.place)  # "the back row's left column"
            if inner.head == "region":
                phrase.bands += inner.bands
                return inner.end
        return None

    def _outside(self, at: int) -> int:
        """`outside`, `outside of the crate`; waiting batteries are the only ones that count."""
        at += self._phrases.word(at) == "of"
        end = at + (self._phrases.kind(at) is Kind.THE)
        return end + 1 if self._phrases.kind(end) in (Kind.CONTAINER, Kind.SURFACE) else at

    def _distance(self, phrase: Phrase, at: int) -> int:
        """`closest`, `furthest from the crate`, `furthest to the left`."""
        phrase.distance = DISTANCES[self._phrases.word(at)]
        at += 1
        start = at
        while self._phrases.word(at) in ("away", "from", "to", "the") or (
            self._phrases.kind(at) is Kind.STATE and at > start
        ):
            at += 1
        if self._phrases.kind(at) is Kind.SIDE and self._phrases.kind(at + 1) not in HEADS:
            phrase.sides.append(SIDES[self._phrases.word(at)])
            phrase.distance = None
            return at + 1
        at = start + (self._phrases.word(start) == "away")
        at += self._phrases.word(at) in ("to", "from")
        if self._phrases.kind(at) in STARTS:
            inner = self._phrases.read(at, self._words.pick)
            if self._refer(phrase, inner):
                return inner.end
        return start

    def _refer(self, phrase: Phrase, inner: Phrase) -> bool:
        """Whether `inner` can be what a distance is measured from; if so, note it."""
        if inner.head == "person":
            phrase.reference = "robot"
        elif inner.head == "container":
            phrase.reference = "holder"
        elif inner.head == "pronoun" and phrase.is_place:
            phrase.reference = "picked"
        elif inner.head == "thing" and not inner.is_place and phrase.is_place:
            phrase.reference = inner.describe() if inner.tells else "picked"
        else:
            return False
        return True

    def _attach(self, phrase: Phrase, inner: Phrase, preposition: str) -> int | None:
        """Join `in the back row`, `on the left`, `of the crate`, `on the table` to the head."""
        is_place = phrase.is_place
        if inner.head == "surface":
            return inner.end
        if inner.head == "container":
            belongs = is_place or phrase.head == "area" or preposition in ("of", "from")
            return inner.end if belongs and preposition != "to" else None
        if inner.head == "region" and is_place and preposition != "to":
            phrase.bands += inner.bands
            phrase.sides += inner.sides  # "in the back row on the left"
            return inner.end
        if inner.head == "thing" and preposition == "of" and inner.category == phrase.category:
            phrase.looks += inner.looks  # "the left-most of the green batteries"
            phrase.sides += inner.sides
            return inner.end
        sided = inner.head in ("area", "none") and inner.sides and not inner.distance
        if not sided or preposition in ("to", "into", "onto", "from") or phrase.chooses:
            return None
        return self._attach_side(phrase, inner)

    def _attach_side(self, phrase: Phrase, inner: Phrase) -> int | None:
        """`on the left side`: of a slot always, of a battery unless it is a side of the crate."""
        # Up to the end of "the middle of the back row", which the inner phrase may not have taken.
        end = inner.end
        if self._phrases.kind(end) is Kind.OF and self._phrases.kind(end + 1) in STARTS:
            end = self._phrases.read(end + 1, self._words.place).end
        within = {token.kind for token in self._phrases.tokens[inner.start : end]}
        if not phrase.is_place and within & {Kind.CONTAINER, Kind.REGION}:
            return None
        phrase.sides += inner.sides
        return inner.end
