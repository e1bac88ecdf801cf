"""What a task draws before targets and words are chosen, and what it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from codediffuser.datagen.scene import ObjectSpec, PlaceSpec, pickable_objects, untaken_places
from codediffuser.errors import ConfigError
from codediffuser.schema import Strict

V = TypeVar("V", bound=Strict)
"""The ranges of one variant, as a task's YAML holds them under `variants`."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Objects and places before targets and words are chosen."""

    objects: tuple[ObjectSpec, ...]
    places: tuple[PlaceSpec, ...]

    @property
    def pickable(self) -> tuple[ObjectSpec, ...]:
        """Objects that move and take no place yet."""
        return pickable_objects(self.objects)

    @property
    def free_places(self) -> tuple[PlaceSpec, ...]:
        """Places that no object takes."""
        return untaken_places(self.objects, self.places)


@dataclass(frozen=True, slots=True)
class LayoutRequest(Generic[V]):
    """What a layout shall be like; what is None is drawn."""

    variant: str
    ranges: V
    """Those of the variant."""
    picks: int | None = None
    """How many objects can be picked."""
    places: int | None = None
    """How many places are free."""

    @property
    def key(self) -> str:
        """YAML mapping that `ranges` were read from, for messages: `variants.sim`."""
        return f"variants.{self.variant}"


def fixed_count(what: str, asked: int | None, count: int) -> None:
    """Check that a number which the variant fixes was asked for, or none.

    Args:
        what: Names the option and the things for the message: `picks: mugs`.
        asked: The number that was asked for.
        count: The only one there is.

    Raises:
        ConfigError: Another number was asked for.
    """
    if asked not in (None, count):
        raise ConfigError(f"{what}: expected {count}, got {asked}")


def drawn_count(
    what: str, asked: int | None, limits: tuple[int, int], rng: np.random.Generator
) -> int:
    """The number that was asked for, checked, or one drawn evenly from low to high.

    Args:
        what: Names the option and the things for the message: `places: free slots`.
        asked: The number that was asked for.
        limits: Low and high, both possible.
        rng: The only source of chance.

    Raises:
        ConfigError: A number beyond the limits was asked for.
    """
    low, high = limits
    if asked is None:
        return int(rng.integers(low, high + 1))
    if not low <= asked <= high:
        raise ConfigError(f"{what}: expected {low} to {high}, got {asked}")
    return asked
