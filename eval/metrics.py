"""Rates with intervals, paired comparison of two policies, and counts of what failed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import TypeVar

from codediffuser.errors import ConfigError

K = TypeVar("K", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Rate:
    """How many of a number of trials came out as wished."""

    successes: int
    trials: int

    @property
    def share(self) -> float:
        """Successes over trials; NaN when there were none."""
        return self.successes / self.trials if self.trials else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson 95 % interval of the share."""
        return wilson_interval(self.successes, self.trials)

    def __str__(self) -> str:
        if not self.trials:
            return "0/0"
        low, high = self.interval
        return (
            f"{self.successes}/{self.trials} = {self.share:.1%} "
            f"[{100 * low:.1f}, {100 * high:.1f}] (95 % Wilson)"
        )


def wilson_interval(
    successes: int, trials: int, *, confidence: float = 0.95
) -> tuple[float, float]:
    """Interval of a binomial share that keeps its coverage near 0 and 1 and for few trials.

    Args:
        successes: 0 to `trials`.
        trials: Any number; with 0 nothing is known, and the interval is (0, 1).
        confidence: Nominal coverage, in (0, 1).

    Raises:
        ValueError: `successes` does not lie in 0..trials.

    Source: Wilson, Probable Inference, the Law of Succession, and Statistical Inference, 1927.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"successes must lie in 0..{trials}, got {successes}")
    if trials == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    share = successes / trials
    shrink = 1 + z * z / trials
    middle = (share + z * z / (2 * trials)) / shrink
    half = z / shrink * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    # The bounds at no and at full success are exactly 0 and 1; rounding must not cross them.
    low = 0.0 if successes == 0 else max(0.0, middle - half)
    high = 1.0 if successes == trials else min(1.0, middle + half)
    return low, high


@dataclass(frozen=True, slots=True)
class PairedComparison:
    """Two policies on the same scenes: how often they agree, and whether one is better."""

    both: int
    only_a: int
    only_b: int
    neither: int

    @property
    def scenes(self) -> int:
        """Number of scenes that both ran."""
        return self.both + self.only_a + self.only_b + self.neither

    @property
    def difference(self) -> float:
        """Success share of a minus that of b."""
        return (self.only_a - self.only_b) / self.scenes

    @property
    def p_value(self) -> float:
        """Two-sided exact McNemar: how likely so lopsided a split is between equal policies."""
        return mcnemar_exact(self.only_a, self.only_b)


def mcnemar_exact(only_a: int, only_b: int) -> float:
    """Two-sided p-value that discordant pairs split as a fair coin would.

    Scenes that both solve or both fail say nothing about which is better and do not enter.

    Source: McNemar, Note on the sampling error of the difference between correlated
    proportions, 1947; the exact form sums the binomial tail instead of a chi-square.
    """
    discordant = only_a + only_b
    if discordant == 0:
        return 1.0
    tail = sum(math.comb(discordant, k) for k in range(min(only_a, only_b) + 1))
    return min(1.0, 2 * tail / 2**discordant)


def compare_paired(a: Mapping[K, bool], b: Mapping[K, bool]) -> PairedComparison:
    """Compare two sets of outcomes, keyed by what identifies a scene, on the scenes they share.

    Raises:
        ConfigError: They share no scene, so nothing can be compared.
    """
    shared = a.keys() & b.keys()
    if not shared:
        raise ConfigError(
            f"expected two results on the same scenes, got {len(a)} and {len(b)} rollouts with no "
            "scene in common; evaluate both with the same task, --seed and scene numbers"
        )
    counts = Counter((a[key], b[key]) for key in shared)
    return PairedComparison(
        both=counts[True, True],
        only_a=counts[True, False],
        only_b=counts[False, True],
        neither=counts[False, False],
    )


def rate(outcomes: Iterable[bool]) -> Rate:
    """Count true outcomes."""
    listed = list(outcomes)
    return Rate(sum(listed), len(listed))


def rates_by(outcomes: Iterable[tuple[K, bool]]) -> dict[K, Rate]:
    """Count outcomes per group, groups in the order in which they first appear."""
    groups: dict[K, list[bool]] = {}
    for key, outcome in outcomes:
        groups.setdefault(key, []).append(outcome)
    return {key: rate(values) for key, values in groups.items()}


def count_failures(failures: Iterable[str | None]) -> dict[str, int]:
    """Count failure phases (None for a success), most frequent first, then by name."""
    counts = Counter(f for f in failures if f is not None)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))
