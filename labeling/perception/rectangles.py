"""Narrow rectangles around points of a plane, and pieces that one rectangle explains together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

TRIM = 0.04
"""Share of the points at each long side of a rectangle that it is measured without: strays."""
END_TRIM = 0.01
"""The same for its ends, which are measured less finely."""
COARSE_RAD, FINE_RAD = 0.02, 0.002
"""Steps in which the angle of a rectangle is looked for."""
MEASURED_POINTS = 400
"""A rectangle is measured by about so many points."""


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle in a plane: `across` is its narrow direction, `along` its long one."""

    angle_rad: float
    """Of the long direction, from the second axis of the plane towards the first."""
    low_m: np.ndarray
    """(2,) across and along."""
    high_m: np.ndarray

    @property
    def size_m(self) -> tuple[float, float]:
        """Width across and length along."""
        width, length = (self.high_m - self.low_m).tolist()
        return width, length

    def outside_m(self, points: np.ndarray) -> np.ndarray:
        """How far points (N, 2) are from the rectangle, (N,), negative within.

        It is the distance to the farthest violated side.
        """
        local = turned(points, self.angle_rad)
        return np.asarray(np.maximum(self.low_m - local, local - self.high_m).max(axis=1))


def turned(points: np.ndarray, angle_rad: float) -> np.ndarray:
    """Coordinates (N, 2), across and along, of points (N, 2)."""
    sin, cos = np.sin(angle_rad), np.cos(angle_rad)
    return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]))


def narrowest_rectangle(points: np.ndarray, angles_rad: np.ndarray) -> Rectangle:
    """The narrowest rectangle that holds points (N, 2), N >= 1, without a few strays.

    Args:
        points: Metres, spread evenly over what they show.
        angles_rad: (A,) angles to choose from, at steps of `COARSE_RAD`.
    """
    chosen = np.linspace(0, len(points) - 1, min(len(points), MEASURED_POINTS)).astype(np.intp)
    points = np.asarray(points[chosen], dtype=np.float64)
    coarse = angles_rad[np.argmin(_widths(points, angles_rad))]
    steps = round(COARSE_RAD / FINE_RAD)
    fine = coarse + FINE_RAD * np.arange(-steps, steps + 1)
    widths = _widths(points, fine)
    # Without its strays a strip looks as narrow when it is turned a little: take the middle.
    angle = float(fine[widths <= (1 + TRIM / 4) * widths.min()].mean())
    across, along = turned(points, angle).T
    low, high = np.quantile(across, [TRIM, 1 - TRIM])
    spare = (high - low) * TRIM / (1 - 2 * TRIM)  # what was trimmed of evenly spread points
    ends = np.quantile(along, [END_TRIM, 1 - END_TRIM])
    return Rectangle(angle, np.array([low - spare, ends[0]]), np.array([high + spare, ends[1]]))


def _widths(points: np.ndarray, angles_rad: np.ndarray) -> np.ndarray:
    """Width (A,) of the strip that holds points (N, 2) without strays, at each angle."""
    low, high = np.quantile(_across(points, angles_rad), [TRIM, 1 - TRIM], axis=1)
    return np.asarray(high - low)


def _across(points: np.ndarray, angles_rad: np.ndarray) -> np.ndarray:
    """Coordinates (A, N) of points (N, 2) across rectangles of all angles."""
    first, second = points.T
    return np.outer(np.cos(angles_rad), first) - np.outer(np.sin(angles_rad), second)


def join_pieces(
    pieces: Sequence[np.ndarray],
    angles_rad: np.ndarray,
    max_size_m: tuple[float, float],
) -> tuple[tuple[int, ...], ...]:
    """Join pieces that fit into one rectangle; the pair that widens least comes first.

    Args:
        pieces: Points (N, 2) of each, N >= 1, metres.
        angles_rad: (A,) angles that rectangles may have.
        max_size_m: Width and length of the largest rectangle; a single piece may be larger.

    Returns:
        Groups of numbers of pieces, each rising, in the order of their first numbers.
    """
    groups: dict[int, tuple[int, ...]] = {i: (i,) for i in range(len(pieces))}
    widths = {i: narrowest_rectangle(p, angles_rad).size_m[0] for i, p in enumerate(pieces)}

    def widening(a: int, b: int) -> float:
        between = pieces[b].mean(axis=0) - pieces[a].mean(axis=0)
        if np.abs(_across(between[None], angles_rad)).min() > max_size_m[0]:
            return float("inf")  # no need to measure: they stand side by side
        joined = _joined(pieces, (*groups[a], *groups[b]), angles_rad)
        if joined.size_m[0] > max_size_m[0] or joined.size_m[1] > max_size_m[1]:
            return float("inf")
        return joined.size_m[0] - max(widths[a], widths[b])

    costs = {(a, b): widening(a, b) for a in groups for b in groups if a < b}
    while costs:
        (a, b), cost = min(costs.items(), key=lambda item: (item[1], item[0]))
        if cost == float("inf"):
            break
        groups[a] = tuple(sorted((*groups[a], *groups.pop(b))))
        widths[a] = _joined(pieces, groups[a], angles_rad).size_m[0]
        costs = {pair: cost for pair, cost in costs.items() if not {a, b} & set(pair)}
        others = sorted(set(groups) - {a})
        costs |= {(min(a, c), max(a, c)): widening(min(a, c), max(a, c)) for c in others}
    return tuple(groups[first] for first in sorted(groups))


def _joined(
    pieces: Sequence[np.ndarray], group: Sequence[int], angles_rad: np.ndarray
) -> Rectangle:
    return narrowest_rectangle(np.concatenate([pieces[i] for i in group]), angles_rad)
