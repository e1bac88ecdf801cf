"""Rollouts to the numbers of a report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from codediffuser.eval.metrics import Rate, compare_paired, count_failures, rate, rates_by
from codediffuser.eval.results import (
    CellValue,
    ComparisonValue,
    ConditionSummary,
    EvalResults,
    RateValue,
    RolloutResult,
    Summary,
)


def summarize(rollouts: Sequence[RolloutResult]) -> Summary:
    """Derive every number that the report shows; an empty evaluation has rates of 0 trials."""
    ordered = sorted(rollouts, key=lambda r: _kind_order(r.kind))
    right = [r for r in rollouts if r.attention.right]
    times = [float(r.first_success_step) for r in rollouts if r.first_success_step is not None]
    return Summary(
        success=rate_value(rate(r.success for r in rollouts)),
        ever_success=rate_value(rate(r.ever_success for r in rollouts)),
        attention_right=rate_value(rate(r.attention.right for r in rollouts)),
        followed=rate_value(rate(r.followed for r in rollouts)),
        success_given_attention_right=rate_value(rate(r.success for r in right)),
        by_kind=_by_kind((r.kind, r.success) for r in ordered),
        attention_by_kind=_by_kind((r.kind, r.attention.right) for r in ordered),
        by_ambiguity=_by_ambiguity(rollouts),
        failures=count_failures(r.failure for r in rollouts),
        conditions=_conditions(rollouts),
        ik_failures=sum(r.ik_failures for r in rollouts),
        rollouts_with_ik_failures=sum(r.ik_failures > 0 for r in rollouts),
        median_wall_s=_median([r.wall_s for r in rollouts]),
        median_success_step=_median(times),
    )


def rate_value(counted: Rate) -> RateValue:
    """Write a rate and its interval out."""
    low, high = counted.interval
    share = counted.share if counted.trials else None
    return RateValue(
        successes=counted.successes, trials=counted.trials, share=share, low=low, high=high
    )


def compare_results(ours: EvalResults, others: Iterable[tuple[str, EvalResults]]) -> EvalResults:
    """Fill in paired comparisons with those of `others` that ran scenes of ours.

    Scenes are matched by the hash of the scene file, so equal numbers of other scenes never meet.

    Args:
        ours: The evaluation to complete.
        others: Name and evaluation of each other one.
    """
    a = {r.scene_sha256: r.success for r in ours.rollouts}
    compared = []
    for name, results in others:
        b = {r.scene_sha256: r.success for r in results.rollouts}
        shared = a.keys() & b.keys()
        if not shared:
            continue
        pairs = compare_paired(a, b)
        compared.append(
            ComparisonValue(
                name=name,
                success_a=rate_value(rate(a[key] for key in shared)),
                success_b=rate_value(rate(b[key] for key in shared)),
                both=pairs.both,
                only_a=pairs.only_a,
                only_b=pairs.only_b,
                neither=pairs.neither,
                p_value=pairs.p_value,
            )
        )
    return ours.model_copy(update={"comparisons": tuple(compared)})


def _kind_order(kind: str) -> tuple[bool, bool, str]:
    """From the words that say everything to those that say nothing."""
    return kind != "no_slackness", kind == "both_slackness", kind


def _by_kind(outcomes: Iterable[tuple[str, bool]]) -> dict[str, RateValue]:
    return {kind: rate_value(counted) for kind, counted in rates_by(outcomes).items()}


def _by_ambiguity(rollouts: Sequence[RolloutResult]) -> tuple[CellValue, ...]:
    cells = rates_by(((r.picks, r.places), r.success) for r in rollouts)
    return tuple(
        CellValue(picks=picks, places=places, successes=r.successes, trials=r.trials)
        for (picks, places), r in sorted(cells.items())
    )


def _conditions(rollouts: Sequence[RolloutResult]) -> tuple[ConditionSummary, ...]:
    judged = [c for r in rollouts if r.final is not None for c in r.final.conditions]
    summaries = []
    for name in dict.fromkeys(c.name for c in judged):
        same = [c for c in judged if c.name == name]
        finite = [c.value for c in same if c.value is not None]
        summaries.append(
            ConditionSummary(
                name=name,
                threshold=same[0].threshold,
                holds=sum(c.holds for c in same),
                median=_median(finite),
                p90=float(np.percentile(finite, 90)) if finite else math.nan,
                values=tuple(c.value for c in same),
            )
        )
    return tuple(summaries)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else math.nan
