"""Noun phrases: `the left-most battery outside the crate`, `slot on the back row`, `another one`.

    phrase    = [determiner] {adjective} [head] {tail}
    head      = battery | slot | one | row | column | side | crate | table | robot | it
    adjective = side | distance | colour | other | free ...
    tail      = on/in/of the <side> row/column | on the <side> [side] [of the table/crate]
              | in/of the crate | outside the crate | on the table
              | <distance> [to/from <reference>] | that is ...

A tail is taken only where it can say something of the head; else it belongs to the sentence, as in
`put the battery | in the left column`.
"""

from __future__ import annotations

from codediffuser.errors import InstructionError
from codediffuser.labeling.language.lexicon import (
    CAN_SAY,
    DISTANCES,
    SIDES,
    Kind,
    Token,
    unknown_word,
)
from codediffuser.labeling.language.meaning import Band, Side
from codediffuser.labeling.language.noun_phrase import Head, Phrase

STARTS = frozenset({
    Kind.ANY, Kind.THE, Kind.ONE, Kind.OTHER, Kind.SIDE, Kind.DISTANCE, Kind.LOOK, Kind.STATE,
    Kind.NUMBER, Kind.BATTERY, Kind.SLOT, Kind.REGION, Kind.AREA, Kind.CONTAINER, Kind.SURFACE,
    Kind.PERSON, Kind.PRONOUN,
})  # fmt: skip
"""Kinds of words that a noun phrase can begin with."""

_HEADS: dict[Kind, Head] = {
    Kind.BATTERY: "thing", Kind.SLOT: "thing", Kind.REGION: "region", Kind.AREA: "area",
    Kind.CONTAINER: "container", Kind.SURFACE: "surface", Kind.PERSON: "person",
    Kind.PRONOUN: "pronoun",
}  # fmt: skip
_ADJECTIVES = frozenset({
    Kind.SIDE, Kind.DISTANCE, Kind.LOOK, Kind.OTHER, Kind.STATE, Kind.NUMBER,
})  # fmt: skip


class PhraseReader:
    """Reads noun phrases from the tokens of one instruction.

    Args:
        tokens: All of it.
        text: As it was written, for messages.
    """

    def __init__(self, tokens: list[Token], text: str) -> None:
        self.tokens = tokens
        self.text = text
        self._known: dict[tuple[int, str], Phrase] = {}

    def kind(self, at: int) -> Kind:
        """Kind of the token at a position; past the end all is a stop."""
        return self.tokens[at].kind if at < len(self.tokens) else Kind.STOP

    def word(self, at: int) -> str:
        """Text of the token at a position; empty past the end."""
        return self.tokens[at].text if at < len(self.tokens) else ""

    def read(self, at: int, default_category: str) -> Phrase:
        """Read the phrase that begins at a position.

        Args:
            at: Position of a token whose kind is in `STARTS`.
            default_category: What `one`, and a phrase without a noun, stands for.

        Raises:
            InstructionError: The words do not make a phrase.
        """
        # What was read is kept: phrases within phrases are looked at more than once.
        if (at, default_category) not in self._known:
            self._known[at, default_category] = self._read(at, default_category)
        return self._known[at, default_category]

    def _read(self, at: int, default_category: str) -> Phrase:
        phrase = Phrase(start=at)
        at = self._determiners(phrase, at)
        at = self._adjectives(phrase, at)
        at = self._head(phrase, at, default_category)
        ends = self.kind(at) in (Kind.STOP, Kind.COMMA, Kind.INTO, Kind.BE)
        if phrase.head == "none" and phrase.definite and not phrase.tells and ends:
            phrase.head = "pronoun"  # "put that in a slot"
        if phrase.head not in ("pronoun", "person", "surface", "container"):
            at = self._tails(phrase, at)
        phrase.end = at
        phrase.said = " ".join(token.text for token in self.tokens[phrase.start : at])
        return phrase

    def _determiners(self, phrase: Phrase, at: int) -> int:
        """`the`, `a`, `one of the`, `any of those`."""
        while True:
            kind = self.kind(at)
            chooses_one = kind in (Kind.ONE, Kind.ANY) or self.word(at) == "each"
            if chooses_one and self.word(at + 1) == "of" and self.kind(at + 2) is Kind.THE:
                at += 3
                while self.kind(at) is Kind.NUMBER:  # "one of the two batteries"
                    at += 1
            elif kind is Kind.ONE and self.kind(at + 1) in _ADJECTIVES | {Kind.BATTERY, Kind.SLOT}:
                at += 1
            elif kind in (Kind.THE, Kind.ANY):
                phrase.definite = kind is Kind.THE
                at += 1
            else:
                return at

    def _adjectives(self, phrase: Phrase, at: int) -> int:
        while True:
            kind, word = self.kind(at), self.word(at)
            if word == "far" and self.kind(at + 1) is Kind.SIDE:
                pass  # "the far left one" is the left one
            elif kind is Kind.SIDE:
                phrase.sides.append(SIDES[word])
            elif kind is Kind.DISTANCE:
                phrase.distance = DISTANCES[word]
            elif kind is Kind.LOOK:
                phrase.looks.append(word)
            elif kind is Kind.OTHER:
                phrase.other = True
            elif kind is Kind.NUMBER:
                phrase.several = True
            elif kind is Kind.CONTAINER and self.kind(at + 1) in _ADJECTIVES | {
                Kind.SLOT, Kind.REGION,
            }:  # fmt: skip
                pass  # "the crate's back row"
            elif kind is not Kind.STATE:
                return at
            at += 1

    def _head(self, phrase: Phrase, at: int, default_category: str) -> int:
        kind, word = self.kind(at), self.word(at)
        phrase.category = default_category
        if kind is Kind.ONE:
            phrase.head = "thing"
            return at + 1
        if kind not in _HEADS:
            complete = phrase.tells or phrase.several or self.kind(at - 1) is Kind.STATE
            stands_alone = kind in (Kind.STOP, Kind.COMMA, Kind.INTO, Kind.BE, Kind.OF)
            if complete or stands_alone or self.word(at - 1) in ("that", "this"):
                return at
            raise InstructionError(
                f"after '{self.word(at - 1)}' the word '{word}' makes no sense to me in "
                f"{self.text!r}; I understand {CAN_SAY}"
            )
        phrase.head = _HEADS[kind]
        if kind is Kind.BATTERY:
            phrase.category = "battery"
            phrase.several |= word.endswith("ies") and not self._chosen_from_many(phrase, at)
        elif kind in (Kind.SLOT, Kind.REGION):
            phrase.category = "slot"
        if kind is Kind.REGION:
            phrase.bands.append(self._band(phrase, word.rstrip("s")))
            phrase.sides, phrase.distance = [], None
        return at + 1

    def _chosen_from_many(self, phrase: Phrase, at: int) -> bool:
        """Whether the plural comes after `one of the` or the like."""
        return any(self.word(i) == "of" for i in range(phrase.start, at))

    def _band(self, phrase: Phrase, axis: str) -> Band:
        """`back row`, `furthest row`, `left column`."""
        sides: list[Side] = list(phrase.sides)
        if axis == "row" and phrase.distance:
            sides.append("front" if phrase.distance == "nearest" else "back")
        allowed = ("front", "middle", "back") if axis == "row" else ("left", "middle", "right")
        if len(sides) != 1 or sides[0] not in allowed or (axis == "column" and phrase.distance):
            raise InstructionError(
                f"a {axis} is one of {', '.join(allowed)}, got '{' '.join(sides) or 'none'}' "
                f"in {self.text!r}"
            )
        return Band("row" if axis == "row" else "column", sides[0])

    def _tails(self, phrase: Phrase, at: int) -> int:
        """Take every tail that says something of the head."""
        while True:
            end = self._tail(phrase, self._skip_relative(at))
            if end is None:
                return at
            at = end

    def _skip_relative(self, at: int) -> int:
        """Pass `that is`, `which are`, `left` (outside), when more of the phrase follows."""
        if self.word(at) == "left" and self.kind(at + 1) in (Kind.OUTSIDE, Kind.INTO):
            return at + 1
        if self.word(at) in ("that", "which", "who") and self.kind(at + 1) is Kind.BE:
            return at + 2
        return at

    def _tail(self, phrase: Phrase, at: int) -> int | None:
        """Read one tail; None when what stands here does not belong to the phrase."""
        kind = self.kind(at)
        if kind is Kind.OUTSIDE:
            return self._outside(at + 1)
        if kind is Kind.DISTANCE and not phrase.chooses:
            return self._distance(phrase, at)
        if kind in (Kind.INTO, Kind.OF) and self.kind(at + 1) in STARTS:
            inner, preposition = self.read(at + 1, phrase.category), self.word(at)
            measured = phrase.distance is not None and phrase.reference is None
            # "the nearest battery to the crate" says rather where the battery goes.
            unclear = preposition == "to" and inner.head == "container"
            measured = measured and preposition in ("to", "from") and not unclear
            if measured and self._refer(phrase, inner):
                return inner.end
            return self._attach(phrase, inner, preposition)
        if kind is Kind.SIDE and phrase.head == "region":
            inner = self.read(at, "slot")  # "the back row's left column"
            if inner.head == "region":
                phrase.bands += inner.bands
                return inner.end
        return None

    def _outside(self, at: int) -> int:
        """`outside`, `outside of the crate`; waiting batteries are the only ones that count."""
        at += self.word(at) == "of"
        end = at + (self.kind(at) is Kind.THE)
        return end + 1 if self.kind(end) in (Kind.CONTAINER, Kind.SURFACE) else at

    def _distance(self, phrase: Phrase, at: int) -> int:
        """`closest`, `furthest from the crate`, `furthest to the left`."""
        phrase.distance = DISTANCES[self.word(at)]
        at += 1
        start = at
        while self.word(at) in ("away", "from", "to", "the") or (
            self.kind(at) is Kind.STATE and at > start
        ):
            at += 1
        if self.kind(at) is Kind.SIDE and self.kind(at + 1) not in _HEADS:
            phrase.sides.append(SIDES[self.word(at)])
            phrase.distance = None
            return at + 1
        at = start + (self.word(start) == "away")
        at += self.word(at) in ("to", "from")
        if self.kind(at) in STARTS:
            inner = self.read(at, "battery")
            if self._refer(phrase, inner):
                return inner.end
        return start

    def _refer(self, phrase: Phrase, inner: Phrase) -> bool:
        """Whether `inner` can be what a distance is measured from; if so, note it."""
        if inner.head == "person":
            phrase.reference = "robot"
        elif inner.head == "container":
            phrase.reference = "crate"
        elif inner.head == "pronoun" and phrase.category == "slot":
            phrase.reference = "picked"
        elif inner.head == "thing" and inner.category == "battery" and phrase.category == "slot":
            phrase.reference = inner.describe() if inner.tells else "picked"
        else:
            return False
        return True

    def _attach(self, phrase: Phrase, inner: Phrase, preposition: str) -> int | None:
        """Join `in the back row`, `on the left`, `of the crate`, `on the table` to the head."""
        is_slot = phrase.category == "slot"
        if inner.head == "surface":
            return inner.end
        if inner.head == "container":
            belongs = is_slot or phrase.head == "area" or preposition in ("of", "from")
            return inner.end if belongs and preposition != "to" else None
        if inner.head == "region" and is_slot and preposition != "to":
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
        if self.kind(end) is Kind.OF and self.kind(end + 1) in STARTS:
            end = self.read(end + 1, "slot").end
        within = {token.kind for token in self.tokens[inner.start : end]}
        if phrase.category == "battery" and within & {Kind.CONTAINER, Kind.REGION}:
            return None
        phrase.sides += inner.sides
        return inner.end

    def unknown(self, at: int) -> InstructionError:
        """The error for a word that has no place in the sentence."""
        return InstructionError(unknown_word(self.word(at), self.text))
