"""Bounded rejection sampling of positions with clearances, and errors that name their remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from codediffuser.errors import PlacementError

Interval = tuple[float, float]

FIRST_TRIES = 32


@dataclass(frozen=True, slots=True)
class KeepOut:
    """A rectangle of the table that centres may not come near."""

    name: str
    """What stands there, for messages: `crate`."""
    x_m: Interval
    y_m: Interval


@dataclass(frozen=True, slots=True)
class Area:
    """Where centres may lie, and how hard to try.

    One layout places its objects one after the other, `max_tries` candidates each; when one finds
    no room, the whole layout is drawn again, `max_redraws` times.
    """

    x_m: Interval
    y_m: Interval
    min_distance_m: float
    """Smallest distance between two centres."""
    max_tries: int
    max_redraws: int
    keep_out: tuple[KeepOut, ...] = ()
    keep_out_margin_m: float = 0.0
    """Smallest distance of a centre from a `KeepOut`: the radius of the objects."""


def sample_positions(
    rng: np.random.Generator, count: int, area: Area, *, keys: str, what: str
) -> np.ndarray:
    """Draw centres that keep their distances.

    Args:
        rng: Generator; how much is drawn from it depends on what it gives.
        count: How many, >= 0.
        area: Ranges and clearances.
        keys: YAML mapping that `area` was read from (`variants.sim`), for messages.
        what: What is placed, plural, for messages.

    Returns:
        xy_m: (count, 2) float64, world.

    Raises:
        PlacementError: No layout was found; the message names the key to change, and to what.
    """
    crowded = False
    for _ in range(max(1, area.max_redraws)):
        placed, crowded = _try_layout(rng, count, area)
        if placed is not None:
            return placed
    raise PlacementError(_explain(count, area, keys, what, crowded))


def _try_layout(rng: np.random.Generator, count: int, area: Area) -> tuple[np.ndarray | None, bool]:
    """One layout (count, 2), or None and whether neighbours (not keep-outs) were the trouble."""
    placed = np.zeros((0, 2))
    crowded = False
    for _ in range(count):
        # A few serve nearly always; all others are drawn at once where it is crowded.
        for tries in (min(FIRST_TRIES, area.max_tries), area.max_tries - FIRST_TRIES):
            fitting, allowed = _candidates(rng, max(0, tries), area, placed)
            crowded = crowded or allowed
            if len(fitting):
                break
        else:
            return None, crowded
        placed = np.concatenate([placed, fitting[:1]])
    return placed, False


def _candidates(
    rng: np.random.Generator, count: int, area: Area, placed: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Drawn centres that fit (N, 2), and whether some kept away from every keep-out."""
    low, high = np.array([area.x_m[0], area.y_m[0]]), np.array([area.x_m[1], area.y_m[1]])
    drawn = rng.uniform(low, high, size=(count, 2))
    allowed = drawn[_outside(drawn, area)]
    gaps = np.linalg.norm(allowed[:, None] - placed[None], axis=-1)
    return allowed[np.all(gaps >= area.min_distance_m, axis=1)], len(allowed) > 0


def _outside(points: np.ndarray, area: Area) -> np.ndarray:
    """Which points (N, 2) keep away from every keep-out rectangle: (N,) bool."""
    free = np.ones(len(points), dtype=bool)
    for box in area.keep_out:
        low, high = np.array([box.x_m[0], box.y_m[0]]), np.array([box.x_m[1], box.y_m[1]])
        gap = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
        free &= gap > area.keep_out_margin_m
    return free


def _explain(count: int, area: Area, keys: str, what: str, crowded: bool) -> str:
    place = (
        f"x {_span(area.x_m)}, y {_span(area.y_m)} m "
        f"({max(1, area.max_redraws)} layouts of {area.max_tries} tries each)"
    )
    if not crowded:
        names = ", ".join(box.name for box in area.keep_out)
        return (
            f"cannot place {count} {what} in {place}: the area lies within "
            f"{area.keep_out_margin_m:g} m of {names}; move '{keys}.area_x_m' or "
            f"'{keys}.area_y_m' away from it"
        )
    works_m = _distance_that_works(count, area)
    fits = works_m >= 2 * area.keep_out_margin_m
    remedy = f"lower '{keys}.min_distance_m' to {works_m:g}" if fits else f"ask for fewer {what}"
    return (
        f"cannot place {count} {what} at least {area.min_distance_m:g} m apart in {place}; "
        f"{remedy}, or widen '{keys}.area_x_m' and '{keys}.area_y_m'"
    )


def _distance_that_works(count: int, area: Area) -> float:
    """A clearance, in whole millimetres, with which ten layouts of ten were found, to suggest."""
    rng = np.random.default_rng(0)  # Only words for a message come from here.
    distance_mm = 1000 * area.min_distance_m
    while distance_mm >= 1:
        distance_mm = np.floor(distance_mm * 0.9)
        trial = replace(area, min_distance_m=distance_mm / 1000)
        if all(_try_layout(rng, count, trial)[0] is not None for _ in range(10)):
            break
    return float(distance_mm) / 1000


def _span(interval: Sequence[float]) -> str:
    return f"[{interval[0]:g}, {interval[1]:g}]"
