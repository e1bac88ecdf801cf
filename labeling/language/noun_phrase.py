"""One noun phrase while it is being read; `describe` gives what it means."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from codediffuser.labeling.language.meaning import (
    Band,
    Description,
    Distance,
    DistanceKind,
    Reference,
    Side,
)

Head = Literal["thing", "region", "area", "container", "surface", "person", "pronoun", "none"]


@dataclass(slots=True)
class Phrase:
    """One noun phrase as it is read."""

    start: int
    end: int = 0
    head: Head = "none"
    category: str = ""
    definite: bool = False
    several: bool = False
    """Whether it speaks of more than one."""
    other: bool = False
    sides: list[Side] = field(default_factory=list)
    bands: list[Band] = field(default_factory=list)
    looks: list[str] = field(default_factory=list)
    distance: DistanceKind | None = None
    reference: Reference | None = None
    said: str = ""
    """Its words."""

    @property
    def chooses(self) -> bool:
        """Whether it is marked by a superlative already."""
        return bool(self.sides or self.distance)

    @property
    def tells(self) -> bool:
        """Whether there is anything in it that could be looked for."""
        return bool(self.chooses or self.bands or self.looks or self.other)

    def describe(self) -> Description:
        """What a phrase about a battery or slot looks for."""
        distance = None
        if self.distance is not None:
            default: Reference = "picked" if self.category == "slot" else "robot"
            distance = Distance(self.distance, self.reference or default)
        return Description(
            category=self.category,
            said=self.said,
            sides=tuple(dict.fromkeys(self.sides)),
            bands=tuple(dict.fromkeys(self.bands)),
            looks=tuple(dict.fromkeys(self.looks)),
            distance=distance,
            other=self.other,
        )
