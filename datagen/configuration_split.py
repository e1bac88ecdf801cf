"""Train, validation and held-out scenes as parts of the configuration space, not as lists of seeds.

A configuration is which object goes from where to which place. It belongs to `held_out` when the
place or the start is reserved by the task's YAML, and otherwise to `val` or `train` by the square
of the table that the object starts in, taken together with the place. So no two splits share a
configuration, whatever the seed, and a file can be checked with nothing but itself.
"""

from __future__ import annotations

import hashlib
import math
from typing import Literal

from pydantic import Field

from codediffuser.schema import Strict

ConfigurationSplit = Literal["train", "val", "held_out"]

PURPOSE = "codediffuser.configuration_split/1"
"""Goes into the hash; a new number deals the squares out anew."""


class Region(Strict):
    """A rectangle of the table."""

    low_m: tuple[float, float]
    high_m: tuple[float, float]

    def contains(self, x_m: float, y_m: float) -> bool:
        """Whether a point lies in it, edges included."""
        (left, front), (right, back) = self.low_m, self.high_m
        return left <= x_m <= right and front <= y_m <= back


class SplitConfig(Strict):
    """The key `splits` of a task's YAML."""

    cell_m: float = Field(default=0.02, gt=0)
    """Side of the squares that starts are sorted into."""
    val_fraction: float = Field(default=0.1, ge=0, lt=1)
    """Share of (square, place) combinations that validation keeps."""
    held_out_places: tuple[str, ...] = ()
    """Ids of places that are targets in `held_out` alone."""
    held_out_region: Region | None = None
    """Starts that occur in `held_out` alone."""


def configuration_split(
    splits: SplitConfig, start_xy_m: tuple[float, float], place_id: str
) -> ConfigurationSplit:
    """The split that a configuration belongs to.

    Args:
        splits: The task's rule.
        start_xy_m: Where the picked object starts, world x and y.
        place_id: Where it goes.
    """
    x, y = start_xy_m
    region = splits.held_out_region
    if place_id in splits.held_out_places or (region is not None and region.contains(x, y)):
        return "held_out"
    column, row = math.floor(x / splits.cell_m), math.floor(y / splits.cell_m)
    digest = hashlib.sha256(f"{PURPOSE}:{place_id}:{column}:{row}".encode()).digest()
    share = int.from_bytes(digest[:8], "big") / 2**64
    return "val" if share < splits.val_fraction else "train"
