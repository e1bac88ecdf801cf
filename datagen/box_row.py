"""What is known of a row of boxes before anything is seen: where it stands, how large they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.book_row import Standing, leaning_pose
from codediffuser.datagen.book_slots import Slot, free_region
from codediffuser.datagen.bookshelf import ShelfConfig


@dataclass(frozen=True, slots=True)
class BoxRow:
    """Boxes that stand or lean side by side along world x, their fronts in one plane.

    The fronts face -y. What does not stand in the row waits to be put there.
    """

    shelf: ShelfConfig
    depth_m: float
    """From front to back, the same for all boxes."""
    thickness_m: tuple[float, float]
    """Along the row, of the thinnest and of the thickest box."""

    def holds(self, points_world: np.ndarray) -> bool:
        """Whether readings (N, 3) of a box, N >= 1, are of one in the row.

        Its front is not farther before the others than a quarter of its depth.
        """
        front_y_m = float(np.quantile(points_world[:, 1], 0.05))
        return front_y_m >= self.shelf.spine_y_m - self.depth_m / 4

    def box(
        self, edge_x_m: float, thickness_m: float, height_m: float, lean_rad: float
    ) -> Standing:
        """A box of the row by the edge that it stands on: the left one unless it leans right."""
        y_m = self.shelf.spine_y_m + self.depth_m / 2
        pose = leaning_pose(edge_x_m, y_m, self.shelf.floor_m, thickness_m, lean_rad)
        return Standing("", pose, thickness_m, height_m, fixed=False)

    def gap_width_m(self, left: Standing, right: Standing) -> float:
        """Free width between two neighbours at its wide end.

        That is the floor, or the top of the lower neighbour.
        """
        a, b, c, d = Slot(left, right).corners_m(self._heights(left, right))[:, 0]
        return float(max(b - a, c - d))

    def gap_region(self, left: Standing, right: Standing) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,), (3,) of the box of the world that is called the gap between neighbours."""
        return free_region(Slot(left, right), self.shelf, self.depth_m)

    def _heights(self, left: Standing, right: Standing) -> tuple[float, float]:
        floor_m = self.shelf.floor_m
        return floor_m, floor_m + min(left.height_m, right.height_m)
