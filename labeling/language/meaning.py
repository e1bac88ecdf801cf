"""What an instruction means, whatever words it was put in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Union

Side = Literal["left", "right", "front", "back", "middle", "top", "bottom"]
DistanceKind = Literal["nearest", "furthest"]
Level = Literal["top", "middle", "bottom"]
Reference = Union["Description", Literal["picked", "robot", "holder"]]
"""What a distance is measured from; `picked` is the object that the instruction picks, `holder`
what all places belong to."""


@dataclass(frozen=True, slots=True)
class Band:
    """A row or column of the holder: `the back row`, `the middle columns`."""

    axis: Literal["row", "column"]
    side: Side


@dataclass(frozen=True, slots=True)
class Distance:
    """Nearest to something, or furthest from it."""

    kind: DistanceKind
    reference: Reference


@dataclass(frozen=True, slots=True)
class Relation:
    """Where a place lies among the things around it."""

    anchors: tuple[Description, ...]
    """One that it is beside, or two that it is between."""
    side: Literal["left", "right"] | None = None
    """On which side of the one; None for either."""
    adjacent: bool = False
    """Whether only the places before the next neighbour are meant, or all up to the end."""

    def same_meaning(self, other: Relation | None) -> bool:
        """Whether another one says the same, whichever of two anchors it names first."""
        return (
            other is not None
            and (self.side, self.adjacent) == (other.side, other.adjacent)
            and len(self.anchors) == len(other.anchors)
            and all(any(a.same_meaning(b) for b in other.anchors) for a in self.anchors)
        )


@dataclass(frozen=True, slots=True)
class Description:
    """One noun phrase: what is looked for, and by which properties."""

    category: str
    said: str
    """The words as they stood, for messages and comments."""
    sides: tuple[Side, ...] = ()
    """`left-most` has one, `front left` two."""
    bands: tuple[Band, ...] = ()
    looks: tuple[str, ...] = ()
    """Words that only seeing can judge: `green`, or a title."""
    distance: Distance | None = None
    level: Level | None = None
    """Of places at different heights."""
    relation: Relation | None = None
    other: bool = False
    """Whether it is one that was not spoken of before: `the other one`."""

    @property
    def is_plain(self) -> bool:
        """Whether it tells nothing but the category."""
        chosen = self.sides or self.bands or self.looks or self.distance or self.level
        return not (chosen or self.relation or self.other)

    def same_meaning(self, other: Description) -> bool:
        """Whether two phrases tell the same properties, in whatever words."""
        return (
            self.category == other.category
            and set(self.sides) == set(other.sides)
            and set(self.bands) == set(other.bands)
            and set(self.looks) == set(other.looks)
            and self.distance == other.distance
            and self.level == other.level
            and _same(self.relation, other.relation)
            and self.other == other.other
        )


def _same(one: Relation | None, other: Relation | None) -> bool:
    return other is None if one is None else one.same_meaning(other)


@dataclass(frozen=True, slots=True)
class Request:
    """An instruction understood: pick this, place it there, leave those alone."""

    pick: Description
    place: Description
    excluded: tuple[Description, ...] = ()
