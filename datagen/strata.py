"""Strata: combinations of levels that a set of scenes is spread over evenly."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeVar

import numpy as np

from codediffuser.datagen.configuration_split import Region
from codediffuser.datagen.instructions.phrasebook import Phrasebook
from codediffuser.datagen.layout import Layout
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.task import Task
from codediffuser.errors import ConfigError, PlacementError
from codediffuser.seeding import Stage, rng_for

SURVEY_LAYOUTS = 200
"""Layouts that are drawn to learn which levels a variant has."""
ORDER_ADDRESS = 2_000_000
"""Attempt number of the generators that shuffle strata; layouts stay far below."""

L = TypeVar("L", int, str)


@dataclass(frozen=True, slots=True)
class Stratum:
    """What one scene is asked to be; None leaves a factor to chance."""

    kind: str | None = None
    template: str | None = None
    """A template's id."""
    picks: int | None = None
    places: int | None = None
    target_place: str | None = None
    start: Region | None = None
    """Part of the table that the picked object starts in."""


def make_strata(
    task: Task, phrasebook: Phrasebook, settings: SamplingSettings
) -> tuple[Stratum, ...]:
    """All combinations of the levels of `settings.stratify` that can occur.

    Numbers of objects and places, and the places themselves, are those that `SURVEY_LAYOUTS`
    layouts of the variant show, so a task need not say them. Starts are sorted into four quarters:
    left and right, near and far half of where objects that wait stand in those layouts.

    Raises:
        ConfigError: No combination can occur.
    """
    asked = set(settings.stratify)
    surveyed = {"picks", "places", "target_place", "start"}
    survey = _survey(task, settings) if asked & surveyed else ()
    templates = phrasebook.templates(picks=settings.picks, places=settings.places)
    picks = _levels("picks" in asked, settings.picks, (len(s.pickable) for s in survey))
    places = _levels("places" in asked, settings.places, (len(s.free_places) for s in survey))
    targets = _levels(
        "target_place" in asked, None,
        (p.id for s in survey for p in s.free_places if _may_be_target(task, settings, p.id)),
    )  # fmt: skip
    starts = _quarters(task, settings, survey) if "start" in asked else (None,)
    kinds: Sequence[tuple[str | None, str | None]] = [(None, None)]
    if "template" in asked:
        kinds = [(t.kind, t.id) for t in templates]
    elif "kind" in asked:
        kinds = [(kind, None) for kind in dict.fromkeys(t.kind for t in templates)]
    found = []
    factors = product(kinds, picks, places, targets, starts)
    for (kind, template), pick, place, target, start in factors:
        sayable = phrasebook.templates(picks=pick, places=place)
        if any(kind in (None, t.kind) and template in (None, t.id) for t in sayable):
            found.append(Stratum(kind, template, pick, place, target, start))
    if not found:
        raise ConfigError(
            f"stratify: no combination of {', '.join(settings.stratify)} can occur in variant "
            f"{settings.variant}, split {settings.split}; ask for fewer factors"
        )
    return tuple(found)


def stratum_of(strata: tuple[Stratum, ...], settings: SamplingSettings, index: int) -> Stratum:
    """The stratum of one scene: every block of `len(strata)` indices has each of them once."""
    block, position = divmod(index, len(strata))
    return strata[_order(len(strata), settings.root_seed, Stage[settings.stage], block)[position]]


@functools.lru_cache(maxsize=8)
def _order(count: int, root_seed: int, stage: Stage, block: int) -> np.ndarray:
    return rng_for(root_seed, stage, block, ORDER_ADDRESS).permutation(count)


def _levels(asked: bool, fixed: L | None, seen: Iterable[L]) -> list[L | None]:
    """The levels of one factor: what is fixed, else all that were seen, else chance."""
    if fixed is not None or not asked:
        return [fixed]
    levels: list[L | None] = []
    levels += sorted(set(seen))
    return levels


def _survey(task: Task, settings: SamplingSettings) -> tuple[Layout, ...]:
    found = []
    for number in range(SURVEY_LAYOUTS):
        try:
            found.append(
                task.sample_layout(
                    rng_for(0, Stage.STRESS, number), variant=settings.variant,
                    picks=settings.picks, places=settings.places,
                )
            )  # fmt: skip
        except PlacementError:
            continue  # The scene that meets this says so, with its number.
    return tuple(found)


def _quarters(
    task: Task, settings: SamplingSettings, survey: Iterable[Layout]
) -> tuple[Region, ...]:
    """Quarters of the table, cut at the median start, that objects of the split start in."""
    starts = [thing.position_m[:2] for layout in survey for thing in layout.pickable]
    starts = [start for start in starts if _may_start(task, settings, start)]
    if not starts:
        return ()
    middle_x, middle_y = np.median(starts, axis=0)
    halves_x = ((-math.inf, float(middle_x)), (float(middle_x), math.inf))
    halves_y = ((-math.inf, float(middle_y)), (float(middle_y), math.inf))
    quarters = [
        Region(low_m=(left, front), high_m=(right, back))
        for (left, right), (front, back) in product(halves_x, halves_y)
    ]
    return tuple(q for q in quarters if any(q.contains(x, y) for x, y in starts))


def _may_start(task: Task, settings: SamplingSettings, start_xy_m: tuple[float, float]) -> bool:
    region = task.config.splits.held_out_region
    if region is None or settings.split in ("all", "eval"):
        return True
    # With places held out too, a held-out scene may start anywhere.
    if settings.split == "held_out" and task.config.splits.held_out_places:
        return True
    return region.contains(*start_xy_m) == (settings.split == "held_out")


def _may_be_target(task: Task, settings: SamplingSettings, place_id: str) -> bool:
    splits = task.config.splits
    if settings.split in ("train", "val"):
        return place_id not in splits.held_out_places
    if settings.split == "held_out" and splits.held_out_region is None:
        return place_id in splits.held_out_places
    return True
