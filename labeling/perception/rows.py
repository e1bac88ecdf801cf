"""Boxes of a row, such as books on a shelf, and the gaps between them, told by their shape.

Votes part what touches, but a box that is partly hidden may fall into pieces, and a gap has no
surface of its own. What is known of the row (`BoxRow`) settles both:

1. Seen from the front, a box is a rectangle that leans the way in which it looks narrowest.
2. Pieces that together are no larger than the largest box are one, for two boxes are not: twice the
   thinnest is thicker than the thickest. Then each reading goes to the box that it lies nearest to,
   and boxes are measured again.
3. Boxes stand on the floor of the row, so their sides are known where nothing shows them. Where
   neighbours leave room between their sides there is a gap: all readings in its region that belong
   to no box.

What does not stand in the row is a box of the same sizes, seen from above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.book_row import Standing
from codediffuser.datagen.box_row import BoxRow
from codediffuser.datagen.task_config import ClusterConfig, RowSearchConfig
from codediffuser.labeling.perception.clustering import NOISE
from codediffuser.labeling.perception.rectangles import (
    COARSE_RAD,
    Rectangle,
    join_pieces,
    narrowest_rectangle,
)
from codediffuser.pointcloud import inside_box
from codediffuser.poses import apply_transform, invert_transform

ROUNDS = 3
"""Of giving readings to boxes and measuring boxes again."""
FRONT_POINTS = 20
"""A box with fewer readings of its front is measured by all that it has."""


@dataclass(frozen=True, slots=True)
class RowBox:
    """One box that was found."""

    shown: np.ndarray
    """(n,) int64: the readings that show it."""
    standing: Standing | None
    """Where it stands in the row; None for one that is elsewhere."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A free space between two neighbours of the row."""

    shown: np.ndarray
    """(n,) int64: the readings in it."""
    middle_world: np.ndarray
    """(3,) float64, metres."""
    beside: tuple[int, int]
    """Indices of the boxes on its left and on its right."""


class RowFinder:
    """Finds the boxes and gaps of one row; see the module.

    Args:
        row: What is known of it.
        search: Tolerances.
        sizes: How many readings a box has at least.
    """

    def __init__(self, row: BoxRow, search: RowSearchConfig, sizes: ClusterConfig) -> None:
        self._row, self._search, self._sizes = row, search, sizes
        self._leans = np.arange(-search.max_lean_rad, search.max_lean_rad, COARSE_RAD)
        self._turns = np.arange(-np.pi / 2, np.pi / 2, COARSE_RAD)
        self._thickest_m = row.thickness_m[1] + search.tolerance_m

    def boxes(self, points_world: np.ndarray, piece: np.ndarray) -> tuple[RowBox, ...]:
        """Tell the boxes that readings show.

        Args:
            points_world: (N, 3) float32, metres: all readings of the category; N may be 0.
            piece: (N,) int64, from 0: the pieces that votes parted; `NOISE` for none.

        Returns:
            The boxes of the row from left to right, then the others.
        """
        pieces = [np.flatnonzero(piece == k) for k in range(piece.max(initial=NOISE) + 1)]
        pieces = [p for p in pieces if len(p)]
        inside = [self._row.holds(points_world[p]) for p in pieces]
        in_row = [p for p, here in zip(pieces, inside, strict=True) if here]
        others = [p for p, here in zip(pieces, inside, strict=True) if not here]
        boxes = [*self._in_row(points_world, in_row), *self._elsewhere(points_world, others)]
        if not boxes:
            return ()
        least = self._sizes.min_share * np.median([len(b.shown) for b in boxes])
        return tuple(b for b in boxes if len(b.shown) >= max(least, self._sizes.min_points))

    def gaps(
        self, cloud_world: np.ndarray, boxes: Sequence[RowBox], min_points: int
    ) -> tuple[Gap, ...]:
        """Tell the gaps of the row from left to right.

        Args:
            cloud_world: (M, 3) float32, metres: all readings, whatever they show.
            boxes: As `boxes` found them.
            min_points: A gap with fewer readings is dropped.
        """
        free = np.ones(len(cloud_world), dtype=bool)
        for box in boxes:
            if box.standing is not None:
                free &= ~self._belongs(cloud_world, box.standing)
        gaps = []
        for left in range(len(boxes) - 1):
            a, b = boxes[left].standing, boxes[left + 1].standing
            if a is None or b is None or self._row.gap_width_m(a, b) < self._search.min_gap_m:
                continue
            low, high = self._row.gap_region(a, b)
            shown = np.flatnonzero(free & inside_box(cloud_world, low, high))
            if len(shown) >= min_points:
                gaps.append(Gap(shown, (low + high) / 2, (left, left + 1)))
        return tuple(gaps)

    def _in_row(self, points: np.ndarray, pieces: Sequence[np.ndarray]) -> list[RowBox]:
        if not pieces:
            return []
        largest = (self._thickest_m, self._row.shelf.height_m)
        fronts = [self._front(points[p]) for p in pieces]
        groups = join_pieces(fronts, self._leans, largest)
        shown = np.concatenate(pieces)
        view = self._from_front(points[shown])
        members = [np.concatenate([pieces[i] for i in g]) for g in groups]
        for _ in range(ROUNDS):
            rectangles = [self._measure(points[m]) for m in members]
            outside = np.stack([r.outside_m(view) for r in rectangles])
            nearest = outside.argmin(axis=0)
            nearest[outside.min(axis=0) > self._search.tolerance_m] = NOISE
            members = [shown[nearest == k] for k in range(len(rectangles))]
            members = [m for m in members if len(m)]
        boxes = [RowBox(np.sort(m), self._stand(self._measure(points[m]))) for m in members]
        return sorted(boxes, key=_middle_x_m)

    def _elsewhere(self, points: np.ndarray, pieces: Sequence[np.ndarray]) -> list[RowBox]:
        largest = (self._thickest_m, self._row.depth_m + self._search.tolerance_m)
        from_above = [points[p][:, :2] for p in pieces]
        boxes = []
        for group in join_pieces(from_above, self._turns, largest):
            shown = np.sort(np.concatenate([pieces[i] for i in group]))
            seen = narrowest_rectangle(points[shown, :2], self._turns)
            near = seen.outside_m(points[shown, :2]) <= self._search.tolerance_m
            boxes.append(RowBox(shown[near], None))
        return boxes

    def _from_front(self, points: np.ndarray) -> np.ndarray:
        """Readings (N, 2) as seen from the front: world x, height above the floor of the row."""
        return points[:, [0, 2]] - np.array([0.0, self._row.shelf.floor_m])

    def _front(self, points: np.ndarray) -> np.ndarray:
        """Readings (n, 2) of the front of a piece, as seen from the front; all if they are few."""
        y = points[:, 1]
        front = self._from_front(points[y <= np.quantile(y, 0.05) + self._search.front_m])
        return front if len(front) >= FRONT_POINTS else self._from_front(points)

    def _measure(self, points: np.ndarray) -> Rectangle:
        """The rectangle of a box, as seen from the front."""
        return narrowest_rectangle(self._front(points), self._leans)

    def _stand(self, seen: Rectangle) -> Standing:
        """The box of a rectangle, which stands on the floor of the row with one of its edges."""
        side_m = seen.high_m[0] if seen.angle_rad > 0 else seen.low_m[0]
        edge_x_m = float(side_m / np.cos(seen.angle_rad))
        foot = edge_x_m * np.sin(seen.angle_rad)
        return self._row.box(edge_x_m, seen.size_m[0], float(seen.high_m[1] - foot), seen.angle_rad)

    def _belongs(self, points: np.ndarray, box: Standing) -> np.ndarray:
        """Which readings (N,) bool are those of a box that stands in the row."""
        local = apply_transform(invert_transform(box.T_world_book), points.astype(np.float64))
        half = np.array([box.thickness_m, self._row.depth_m, box.height_m]) / 2
        outside = np.abs(local - np.array([0.0, 0.0, half[2]])) - half
        return np.asarray(outside.max(axis=1) <= self._search.margin_m)


def _middle_x_m(box: RowBox) -> float:
    """World x of the middle of a box of the row."""
    assert box.standing is not None
    T = box.standing.T_world_book
    return float(T[0, 3] + T[0, 2] * box.standing.height_m / 2)
