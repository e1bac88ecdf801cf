"""What went wrong with the messages of one topic: missing, late, out of order, twice, unsteady."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SHOWN = 50
"""Faults of one topic that are told one by one; beyond these they are only counted."""

GAP_FACTOR = 1.5
"""An interval longer than this many periods lacks a message."""

_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Faults of one topic."""

    messages: int
    rate_hz: float
    """From the median interval; 0 for fewer than two messages."""
    jitter_p95_ms: float
    """95th percentile of how much an interval differs from the median one, gaps left out."""
    missing: int
    late: int
    reordered: int
    duplicates: int
    faults: tuple[str, ...]
    """In words, by time."""

    @property
    def missing_share(self) -> float:
        """Missing messages among those that the rate would have brought."""
        return self.missing / max(self.missing + self.messages, 1)


def examine_arrivals(
    bag_ns: np.ndarray, header_ns: np.ndarray | None, origin_ns: int, *, by_header: bool
) -> Arrivals:
    """Look for faults in the times of one topic.

    Args:
        bag_ns: (n,) int64 receive times in the order of arrival.
        header_ns: (n,) int64 time stamps of the sender, or None when it gives none; without them
            lateness, order and duplicates cannot be told.
        origin_ns: What faults are told relative to, on the bag's clock.
        by_header: Whether rate and jitter are those of the sender's stamps.
    """
    stamps = bag_ns if header_ns is None else header_ns
    offset = 0
    if header_ns is not None and len(bag_ns):
        # The sender's clock may differ; faults are told on the bag's.
        offset = int(np.median(bag_ns - header_ns))
    ordered = np.unique(stamps)
    period = float(np.median(np.diff(ordered))) if len(ordered) > 1 else 0.0
    told: list[tuple[int, str]] = []
    missing = _missing(ordered + offset, period, told)
    late = reordered = duplicates = 0
    if header_ns is not None:
        late = _late(bag_ns, header_ns, period, told)
        reordered, duplicates = _order(bag_ns, header_ns, told)
    told.sort()
    words = [f"{text} at {(time - origin_ns) / 1e9:.3f} s" for time, text in told[:SHOWN]]
    if len(told) > SHOWN:
        words.append(f"and {len(told) - SHOWN} more")
    clock = stamps if by_header else bag_ns
    return Arrivals(
        len(bag_ns),
        1e9 / period if period else 0.0,
        _jitter_ms(np.sort(clock), period),
        missing, late, reordered, duplicates, tuple(words),
    )  # fmt: skip


def _missing(times: np.ndarray, period: float, told: list[tuple[int, str]]) -> int:
    if not period:
        return 0
    gaps = np.diff(times) / period
    total = 0
    for i in np.flatnonzero(gaps > GAP_FACTOR):
        count = round(float(gaps[i])) - 1
        if count > 0:
            total += count
            told.append((int(times[i]), f"{count} missing"))
    return total


def _late(
    bag_ns: np.ndarray, header_ns: np.ndarray, period: float, told: list[tuple[int, str]]
) -> int:
    """Messages whose way took longer than usual by more than one period, or clearly more."""
    latency = (bag_ns - header_ns).astype(np.float64)
    usual = float(np.median(latency)) if len(latency) else 0.0
    spread = float(np.median(np.abs(latency - usual))) * _MAD_TO_SIGMA if len(latency) else 0.0
    late = np.flatnonzero(latency - usual > max(period, 6 * spread, 1e6))
    for i in late:
        told.append((int(bag_ns[i]), f"late by {(latency[i] - usual) / 1e6:.0f} ms"))
    return len(late)


def _order(
    bag_ns: np.ndarray, header_ns: np.ndarray, told: list[tuple[int, str]]
) -> tuple[int, int]:
    """Count messages with an older stamp than one before, and those with the same stamp again."""
    if not len(header_ns):
        return 0, 0
    newest = np.maximum.accumulate(header_ns)
    seen_before = np.ones(len(header_ns), bool)
    seen_before[np.unique(header_ns, return_index=True)[1]] = False
    overtaken = np.append(False, header_ns[1:] < newest[:-1]) & ~seen_before
    for i in np.flatnonzero(overtaken):
        told.append((int(bag_ns[i]), "out of order"))
    for i in np.flatnonzero(seen_before):
        told.append((int(bag_ns[i]), "stamp used twice"))
    return int(overtaken.sum()), int(seen_before.sum())


def _jitter_ms(times: np.ndarray, period: float) -> float:
    intervals = np.diff(times)
    intervals = intervals[(intervals > 0) & (intervals <= GAP_FACTOR * period)]
    if not len(intervals):
        return 0.0
    return float(np.percentile(np.abs(intervals - period), 95)) / 1e6
