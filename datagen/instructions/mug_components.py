"""Phrases for mugs and for the branches of a mug tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from codediffuser.datagen.instructions.components import Arrangement, Component


@dataclass(frozen=True, slots=True)
class MugCalled(Component):
    """The mug that bears this name: `red mug`. No two mugs of a scene have the same colour."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """Ids of the waiting mugs of that name, sorted."""
        return tuple(sorted(o.id for o in scene.pickable if o.name == self.words))


@dataclass(frozen=True, slots=True)
class BranchAt(Component):
    """The one free branch on a side of the tree, or at a level of it: `right-topmost branch`.

    Sides and levels are those of all branches that are used, whether or not they are free.
    """

    side: tuple[float, float] | None
    """Unit vector on the table, world x and y; None for either side."""
    level: Literal["top", "middle"] | None
    """Among the highest branches, or below them; None for any height."""
    margin_m: float
    """How far from the middle, or below the highest, a branch must lie to count."""

    def extract(self, scene: Arrangement, pick_id: str | None = None) -> tuple[str, ...]:
        """The branch, or nothing when several free ones would do."""
        points = {p.id: np.array(p.position_m) for p in scene.places}
        if not points:
            return ()
        highest = max(point[2] for point in points.values())
        middle = np.mean([point[:2] for point in points.values()], axis=0)
        named = [
            p.id
            for p in scene.free_places
            if self._on_side(points[p.id][:2] - middle)
            and self._on_level(highest - points[p.id][2])
        ]
        return (named[0],) if len(named) == 1 else ()

    def _on_side(self, offset_m: np.ndarray) -> bool:
        return self.side is None or float(np.dot(offset_m, self.side)) > self.margin_m

    def _on_level(self, below_m: float) -> bool:
        if self.level is None:
            return True
        return (below_m < self.margin_m) == (self.level == "top")
