"""Statistics of features in LeRobot's form, exact, and how those of episodes join to a dataset's.

Points have statistics per channel, over all points of all frames: five numbers, where LeRobot's own
writer would keep one set for each of the 2560 columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codediffuser.errors import ShapeError

Stats = dict[str, np.ndarray]
"""`min max mean std q01 q10 q50 q90 q99`, each (D,) float64, and `count` (1,) int64: frames."""

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def feature_stats(values: np.ndarray, count: int | None = None) -> Stats:
    """Exact statistics of each column.

    Args:
        values: (M, D) numbers with M >= 1. Points come as one row per point.
        count: Frames that the rows stand for; None for one row per frame. Weighs the mean when
            statistics are merged.

    Raises:
        ShapeError: `values` is not (M, D), or empty.
    """
    if values.ndim != 2 or len(values) == 0:
        raise ShapeError(f"statistics need shape (M, D) with M >= 1, got {values.shape}")
    exact = values.astype(np.float64)
    stats = {
        "min": exact.min(axis=0),
        "max": exact.max(axis=0),
        "mean": exact.mean(axis=0),
        "std": exact.std(axis=0),
        "count": np.array([len(values) if count is None else count], dtype=np.int64),
    }
    quantiles = np.quantile(exact, list(QUANTILES.values()), axis=0)
    return {**stats, **dict(zip(QUANTILES, quantiles, strict=True))}


STEP = 2.0**-10
"""Width of the bins of a `Histogram`: 1 mm for metres."""


@dataclass(frozen=True, slots=True)
class Histogram:
    """How often the values of one column fell into bins of fixed width; few of them are not empty.

    Histograms of parts add up to that of the whole, so quantiles of any union of episodes are known
    to within `STEP / 2`.
    """

    bins: np.ndarray
    """(B,) int64, ascending: value / `STEP`, rounded."""
    counts: np.ndarray
    """(B,) int64."""

    @classmethod
    def of(cls, values: np.ndarray) -> Histogram:
        """Count (M,) finite numbers."""
        bins, counts = np.unique(np.rint(values / STEP).astype(np.int64), return_counts=True)
        return cls(bins, counts.astype(np.int64))

    @classmethod
    def sum(cls, parts: Sequence[Histogram]) -> Histogram:
        """Histogram of all parts together."""
        bins = np.concatenate([part.bins for part in parts])
        counts = np.concatenate([part.counts for part in parts])
        joined, where = np.unique(bins, return_inverse=True)
        total = np.zeros(len(joined), dtype=np.int64)
        np.add.at(total, where, counts)
        return cls(joined, total)

    def quantiles(self) -> np.ndarray:
        """Values (5,) float64 of `QUANTILES`."""
        reached = self.counts.cumsum() / self.counts.sum()
        found = np.searchsorted(reached, list(QUANTILES.values()))
        return np.asarray(self.bins[found] * STEP)


def with_quantiles(stats: Stats, quantiles: np.ndarray) -> Stats:
    """The same statistics with other quantiles, (5, D) in the order of `QUANTILES`."""
    return {**stats, **dict(zip(QUANTILES, quantiles, strict=True))}


def merge_stats(parts: Sequence[Stats]) -> Stats:
    """Statistics of several episodes together.

    `min max mean std count` are those of all the data. Quantiles are means weighted by frames, as
    LeRobot joins them, so its merge and split tools give the same numbers.

    Raises:
        ShapeError: No parts.
    """
    if not parts:
        raise ShapeError("no statistics to merge")
    counts = np.array([part["count"] for part in parts], dtype=np.float64)
    weights = counts / counts.sum()

    def stack(name: str) -> np.ndarray:
        return np.stack([np.asarray(part[name], dtype=np.float64) for part in parts])

    mean = (weights * stack("mean")).sum(axis=0)
    variance = (weights * (stack("std") ** 2 + (stack("mean") - mean) ** 2)).sum(axis=0)
    merged = {
        "min": stack("min").min(axis=0),
        "max": stack("max").max(axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": np.array([int(counts.sum())], dtype=np.int64),
    }
    return {**merged, **{name: (weights * stack(name)).sum(axis=0) for name in QUANTILES}}
