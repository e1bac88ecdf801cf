"""What an instruction means, whatever words it was put in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Union

Side = Literal["left", "right", "front", "back", "middle"]
DistanceKind = Literal["nearest", "furthest"]
Reference = Union["Description", Literal["picked", "robot", "crate"]]
"""What a distance is measured from; `picked` is the object that the instruction picks."""


@dataclass(frozen=True, slots=True)
class Band:
    """A row or column of the crate: `the back row`, `the middle columns`."""

    axis: Literal["row", "column"]
    side: Side


@dataclass(frozen=True, slots=True)
class Distance:
    """Nearest to something, or furthest from it."""

    kind: DistanceKind
    reference: Reference


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
    """Words that only seeing can judge: `green`."""
    distance: Distance | None = None
    other: bool = False
    """Whether it is one that was not spoken of before: `the other one`."""

    @property
    def is_plain(self) -> bool:
        """Whether it tells nothing but the category."""
        return not (self.sides or self.bands or self.looks or self.distance or self.other)

    def same_meaning(self, other: Description) -> bool:
        """Whether two phrases tell the same properties, in whatever words."""
        return (
            self.category == other.category
            and set(self.sides) == set(other.sides)
            and set(self.bands) == set(other.bands)
            and set(self.looks) == set(other.looks)
            and self.distance == other.distance
            and self.other == other.other
        )


@dataclass(frozen=True, slots=True)
class Request:
    """An instruction understood: pick this, place it there, leave those alone."""

    pick: Description
    place: Description
    excluded: tuple[Description, ...] = ()
