"""Places by the things around them: `right next to COMET on its left side`, `between A and B`.

    relation = adjacent anchor [on/to [the] <side> [side]]
             | adjacent <side> of anchor
             | [on/to] [the] <side> [side] of anchor
             | on/to anchor <side> [side]
             | between anchor and anchor
    anchor   = [the] {adjective} (book | TITLE)

`adjacent` is what all ways to say "next to" are rewritten to.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from codediffuser.labeling.language.lexicon import SIDES, Kind
from codediffuser.labeling.language.meaning import Description, Relation

if TYPE_CHECKING:
    from codediffuser.labeling.language.phrases import PhraseReader

Found = tuple[Relation, int]
"""A relation, and the position after it."""
Sided = tuple[Literal["left", "right"], int]


class RelationReader:
    """Reads relations from the tokens of one instruction.

    Args:
        phrases: Reads the anchors.
    """

    def __init__(self, phrases: PhraseReader) -> None:
        self._phrases = phrases
        self._pick = phrases.lexicon.vocabulary.pick
        self._spoken = phrases.lexicon.vocabulary.neighbours

    def read(self, at: int) -> Found | None:
        """The relation that begins at a position; None when none does."""
        if not self._spoken:
            return None
        kind = self._phrases.kind(at)
        if kind is Kind.BETWEEN:
            return self._between(at + 1)
        if kind is Kind.BESIDE:
            return self._side_of(at + 1, adjacent=True) or self._beside(at + 1)
        start = at + 1 if kind is Kind.INTO else at
        if kind in (Kind.INTO, Kind.THE, Kind.SIDE):
            found = self._side_of(start, adjacent=False)
            if found is not None or kind is not Kind.INTO:
                return found
            return self._on_its_side(start)
        return None

    def follows(self, at: int) -> bool:
        """Whether one begins at a position, or later in the same sentence."""
        while self._phrases.kind(at) is not Kind.STOP:
            if self.read(at) is not None:
                return True
            at += 1
        return False

    def _between(self, at: int) -> Found | None:
        first = self._anchor(at)
        if first is None or self._phrases.word(first[1]) != "and":
            return None
        second = self._anchor(first[1] + 1)
        if second is None:
            return None
        return Relation((first[0], second[0])), second[1]

    def _beside(self, at: int) -> Found | None:
        """The anchor, and maybe its side: `COMET on its left side`."""
        anchor = self._anchor(at)
        if anchor is None:
            return None
        end = anchor[1]
        if self._phrases.kind(end) is Kind.INTO and (side := self._side(end + 1)) is not None:
            return Relation((anchor[0],), side[0], adjacent=True), side[1]
        return Relation((anchor[0],), adjacent=True), end

    def _side_of(self, at: int, *, adjacent: bool) -> Found | None:
        """`the left side of COMET`."""
        side = self._side(at)
        if side is None or self._phrases.word(side[1]) != "of":
            return None
        anchor = self._anchor(side[1] + 1)
        return None if anchor is None else (Relation((anchor[0],), side[0], adjacent), anchor[1])

    def _on_its_side(self, at: int) -> Found | None:
        """`COMET's left side`, after the preposition."""
        anchor = self._anchor(at)
        side = None if anchor is None else self._side(anchor[1])
        if anchor is None or side is None:
            return None
        return Relation((anchor[0],), side[0]), side[1]

    def _side(self, at: int) -> Sided | None:
        """`the left`, `its left side`."""
        at += self._phrases.kind(at) is Kind.THE
        side = SIDES.get(self._phrases.word(at))
        if side != "left" and side != "right":
            return None
        return side, at + 1 + (self._phrases.kind(at + 1) is Kind.AREA)

    def _anchor(self, at: int) -> tuple[Description, int] | None:
        """The thing that a place is beside."""
        phrase = self._phrases.read_plain(at, self._pick)
        if phrase is None or phrase.head != "thing" or phrase.is_place:
            return None
        return phrase.describe(), phrase.end
