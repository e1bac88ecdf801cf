"""Descriptive phrases that can be checked by rule: each knows which things of a scene it names.

Directions are those of an observer at the robot (`Observer`): right, left, far, near. Every phrase
keeps a margin, so that it names nothing where two things tie within it: a person, a camera or a
policy could not tell them apart either.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from codediffuser.datagen.scene import ObjectSpec, PlaceSpec


class Arrangement(Protocol):
    """What phrases look at: a `SceneSpec`, or the `Layout` that becomes one."""

    @property
    def objects(self) -> tuple[ObjectSpec, ...]:
        """All objects, those that stay where they are too."""

    @property
    def places(self) -> tuple[PlaceSpec, ...]:
        """All places, taken or free."""

    @property
    def pickable(self) -> tuple[ObjectSpec, ...]:
        """Objects that wait to be picked."""

    @property
    def free_places(self) -> tuple[PlaceSpec, ...]:
        """Places that nothing takes yet."""


@dataclass(frozen=True, slots=True)
class Component(ABC):
    """One phrase."""

    words: str
    """How it is said, without article: `left-most battery`."""
    category: str
    """What it describes; the placeholder that it fills."""

    @abstractmethod
    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """Ids that the words name, sorted; empty when they name nothing, or not clearly.

        Args:
            scene: The arrangement that is spoken about.
            pick_id: The object that is picked, for phrases relative to it ("nearest slot"). None
                asks for everything that the words name for some object.
        """

    def check(self, scene: Arrangement) -> bool:
        """Whether there is something in the scene that the words name."""
        return bool(self.extract(scene))


@dataclass(frozen=True, slots=True)
class ExtremeObject(Component):
    """The object farthest along a direction, among those that wait: `left-most battery`.

    A lone object is the extreme in every direction.
    """

    direction: tuple[float, float]
    """Unit vector on the table, world x and y."""
    margin_m: float
    """How far ahead of the next one it must be."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """The one object, or nothing when the next one comes within the margin."""
        values = {o.id: float(np.dot(o.position_m[:2], self.direction)) for o in scene.pickable}
        return clear_maximum(values, self.margin_m)


@dataclass(frozen=True, slots=True)
class PlaceBand(Component):
    """Free places in one row or column of a grid: `slot on the front-most row`.

    Rows and columns are those of the grid itself, whether or not they have free places.
    """

    direction: tuple[float, float]
    """Unit vector on the table, world x and y."""
    band: Literal["first", "inner"]
    """The band farthest along `direction`, or all between it and the opposite one."""
    margin_m: float
    """Places within this distance along `direction` are in one band: less than half a pitch."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """Ids of the free places of the band, sorted."""
        along = {p.id: float(np.dot(p.position_m[:2], self.direction)) for p in scene.places}
        if not along:
            return ()
        low, high = min(along.values()) + self.margin_m, max(along.values()) - self.margin_m
        if self.band == "first":
            members = {i for i, value in along.items() if value > high}
        else:
            members = {i for i, value in along.items() if low <= value <= high}
        return tuple(sorted(p.id for p in scene.free_places if p.id in members))


@dataclass(frozen=True, slots=True)
class PlaceByDistance(Component):
    """The free place nearest to, or furthest from, the object that is picked, in x, y and z."""

    extreme: Literal["nearest", "furthest"]
    margin_m: float
    """How much nearer (further) than the next place it must be."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """The one place for a picked object; for none given, those of all waiting objects."""
        sign = -1.0 if self.extreme == "nearest" else 1.0
        named: set[str] = set()
        for thing in scene.pickable:
            if pick_id in (None, thing.id):
                distances = {
                    p.id: sign * float(np.linalg.norm(np.subtract(p.position_m, thing.position_m)))
                    for p in scene.free_places
                }
                named.update(clear_maximum(distances, self.margin_m))
        return tuple(sorted(named))


def clear_maximum(values: dict[str, float], margin: float) -> tuple[str, ...]:
    """Key of the largest value, if it leads by at least `margin`; a lone key always does."""
    ranked = sorted(values, key=lambda key: values[key], reverse=True)
    if not ranked:
        return ()
    if len(ranked) > 1 and values[ranked[0]] - values[ranked[1]] < margin:
        return ()
    return (ranked[0],)


def extremes(
    category: str, names: Sequence[tuple[str, tuple[float, float]]], margin_m: float
) -> list[Component]:
    """`<name> <category>` for each name and direction: `left-most battery`, ..."""
    return [
        ExtremeObject(f"{name} {category}", category, direction=direction, margin_m=margin_m)
        for name, direction in names
    ]
