"""Noun phrases: `the left-most battery outside the crate`, `slot on the back row`, `another one`.

    phrase    = [determiner] {adjective} [head] {tail}
    head      = battery | slot | TITLE | one | row | column | side | crate | table | robot | it
    adjective = side | distance | colour | other | free ...

Battery, slot and crate stand for the nouns of the task. Tails are read in `tails.py`.
"""

from __future__ import annotations

from codediffuser.errors import InstructionError
from codediffuser.labeling.language.lexicon import DISTANCES, SIDES, Kind
from codediffuser.labeling.language.meaning import Band, Side
from codediffuser.labeling.language.noun_phrase import HEADS, STARTS, Phrase
from codediffuser.labeling.language.relations import RelationReader
from codediffuser.labeling.language.tails import TailReader
from codediffuser.labeling.language.tokens import Lexicon, Token

_ADJECTIVES = frozenset({
    Kind.SIDE, Kind.DISTANCE, Kind.LOOK, Kind.OTHER, Kind.STATE, Kind.NUMBER,
})  # fmt: skip


class PhraseReader:
    """Reads noun phrases from the tokens of one instruction.

    Args:
        tokens: All of it.
        text: As it was written, for messages.
        lexicon: The words of the task.
    """

    def __init__(self, tokens: list[Token], text: str, lexicon: Lexicon) -> None:
        self.tokens = tokens
        self.text = text
        self.lexicon = lexicon
        self._words = lexicon.vocabulary
        self._known: dict[tuple[int, str], Phrase] = {}
        self.relations = RelationReader(self)
        self._tails = TailReader(self)

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

    def read_plain(self, at: int, default_category: str) -> Phrase | None:
        """Read a phrase up to its head, without what may follow; None when there is none."""
        if self.kind(at) not in STARTS:
            return None
        phrase = Phrase(start=at)
        try:
            phrase.end = self._up_to_head(phrase, at, default_category)
        except InstructionError:
            return None
        phrase.said = self._said(phrase)
        return phrase

    def _up_to_head(self, phrase: Phrase, at: int, default_category: str) -> int:
        at = self._determiners(phrase, at)
        at = self._adjectives(phrase, at)
        at = self._head(phrase, at, default_category)
        self._take_level(phrase)
        return at

    def _said(self, phrase: Phrase) -> str:
        return " ".join(token.text for token in self.tokens[phrase.start : phrase.end])

    def _read(self, at: int, default_category: str) -> Phrase:
        phrase = Phrase(start=at)
        at = self._up_to_head(phrase, at, default_category)
        ends = self.kind(at) in (Kind.STOP, Kind.COMMA, Kind.INTO, Kind.BE)
        if phrase.head == "none" and phrase.definite and not phrase.tells and ends:
            phrase.head = "pronoun"  # "put that in a slot"
        if phrase.head not in ("pronoun", "person", "surface", "container", "aside"):
            at = self._tails.read(phrase, at)
        phrase.end = at
        phrase.said = self._said(phrase)
        return phrase

    def _take_level(self, phrase: Phrase) -> None:
        """`right-topmost branch`: of places at several heights, one of the sides is a level."""
        if self._words.level_m is None or not phrase.is_place or phrase.head == "area":
            return
        for level in ("top", "middle", "bottom"):
            if level in phrase.sides:
                phrase.level = level
                phrase.sides = [side for side in phrase.sides if side != level]

    def _determiners(self, phrase: Phrase, at: int) -> int:
        """`the`, `a`, `one of the`, `any of those`."""
        while True:
            kind = self.kind(at)
            chooses_one = kind in (Kind.ONE, Kind.ANY) or self.word(at) == "each"
            if chooses_one and self.word(at + 1) == "of" and self.kind(at + 2) is Kind.THE:
                at += 3
                while self.kind(at) is Kind.NUMBER:  # "one of the two batteries"
                    at += 1
            elif kind is Kind.ONE and self.kind(at + 1) in _ADJECTIVES | {Kind.PICK, Kind.PLACE}:
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
                Kind.PLACE, Kind.REGION,
            }:  # fmt: skip
                pass  # "the crate's back row"
            elif kind is not Kind.STATE:
                return at
            at += 1

    def _head(self, phrase: Phrase, at: int, default_category: str) -> int:
        kind, word = self.kind(at), self.word(at)
        phrase.category = default_category
        phrase.is_place = default_category == self._words.place
        if kind is Kind.ONE:
            phrase.head = "thing"
            return at + 1
        if kind not in HEADS:
            complete = phrase.tells or phrase.several or self.kind(at - 1) is Kind.STATE
            stands_alone = kind in (Kind.STOP, Kind.COMMA, Kind.INTO, Kind.BE, Kind.OF)
            if complete or stands_alone or self.word(at - 1) in ("that", "this"):
                return at
            raise InstructionError(
                f"after '{self.word(at - 1)}' the word '{word}' makes no sense to me in "
                f"{self.text!r}; I understand {self._words.can_say}"
            )
        phrase.head = HEADS[kind]
        if kind in (Kind.PICK, Kind.TITLE):
            phrase.category, phrase.is_place = self._words.pick, False
            many = word.endswith("s") and kind is Kind.PICK
            phrase.several |= many and not self._chosen_from_many(phrase, at)
        elif kind in (Kind.PLACE, Kind.REGION):
            phrase.category, phrase.is_place = self._words.place, True
        if kind is Kind.TITLE:
            phrase.looks.append(word)
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
