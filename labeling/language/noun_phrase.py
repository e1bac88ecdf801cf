"""One noun phrase while it is being read; `describe` gives what it means."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from codediffuser.labeling.language.lexicon import Kind
from codediffuser.labeling.language.meaning import (
    Band,
    Description,
    Distance,
    DistanceKind,
    Level,
    Reference,
    Relation,
    Side,
)

Head = Literal[
    "thing", "region", "area", "container", "surface", "person", "pronoun", "aside", "none"
]  # fmt: skip

STARTS = frozenset({
    Kind.ANY, Kind.THE, Kind.ONE, Kind.OTHER, Kind.SIDE, Kind.DISTANCE, Kind.LOOK, Kind.STATE,
    Kind.NUMBER, Kind.PICK, Kind.PLACE, Kind.TITLE, Kind.REGION, Kind.AREA, Kind.CONTAINER,
    Kind.SURFACE, Kind.PERSON, Kind.PRONOUN, Kind.ASIDE,
})  # fmt: skip
"""Kinds of words that a noun phrase can begin with."""

HEADS: dict[Kind, Head] = {
    Kind.PICK: "thing", Kind.PLACE: "thing", Kind.TITLE: "thing", Kind.REGION: "region",
    Kind.AREA: "area", Kind.CONTAINER: "container", Kind.SURFACE: "surface",
    Kind.PERSON: "person", Kind.PRONOUN: "pronoun", Kind.ASIDE: "aside",
}  # fmt: skip
"""Kinds of words that can be the head of one, and what kind of head."""


@dataclass(slots=True)
class Phrase:
    """One noun phrase as it is read."""

    start: int
    end: int = 0
    head: Head = "none"
    category: str = ""
    is_place: bool = False
    """Whether it speaks of what something is placed at, not of what is picked."""
    definite: bool = False
    several: bool = False
    """Whether it speaks of more than one."""
    other: bool = False
    sides: list[Side] = field(default_factory=list)
    bands: list[Band] = field(default_factory=list)
    looks: list[str] = field(default_factory=list)
    distance: DistanceKind | None = None
    reference: Reference | None = None
    level: Level | None = None
    relation: Relation | None = None
    said: str = ""
    """Its words."""

    @property
    def chooses(self) -> bool:
        """Whether it is marked by a superlative already."""
        return bool(self.sides or self.distance)

    @property
    def tells(self) -> bool:
        """Whether there is anything in it that could be looked for."""
        placed = self.bands or self.level or self.relation
        return bool(self.chooses or placed or self.looks or self.other)

    def describe(self) -> Description:
        """What a phrase about a thing or place looks for."""
        distance = None
        if self.distance is not None:
            default: Reference = "picked" if self.is_place else "robot"
            distance = Distance(self.distance, self.reference or default)
        return Description(
            category=self.category,
            said=self.said,
            sides=tuple(dict.fromkeys(self.sides)),
            bands=tuple(dict.fromkeys(self.bands)),
            looks=tuple(dict.fromkeys(self.looks)),
            distance=distance,
            level=self.level,
            relation=self.relation,
            other=self.other,
        )
