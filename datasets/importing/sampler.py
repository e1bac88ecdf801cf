"""Which message of each signal a frame takes: pure functions of times, and the law of the import.

No frame takes a message from its future. Two things look ahead, and only where the configuration
asks for it: interpolation of numbers, and commands of the following frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

Method = Literal["latest", "linear", "next"]


@dataclass(frozen=True, slots=True)
class SignalTimes:
    """When the messages of one signal were, and how they are sampled."""

    times_ns: np.ndarray
    """(n,) int64, ascending."""
    max_age_ns: int
    method: Method = "latest"


@dataclass(frozen=True, slots=True)
class Samples:
    """What one signal gives to the frames."""

    index: np.ndarray
    """(T,) int64 places in `times_ns`, never -1 in a plan."""
    age_ns: np.ndarray
    """(T,) int64: frame time minus message time; not negative unless `method` is `next`."""
    weight: np.ndarray
    """(T,) float64 in [0, 1): how much of the following message is mixed in; 0 unless linear."""


@dataclass(frozen=True, slots=True)
class FramePlan:
    """All frames of one episode."""

    frames_ns: np.ndarray
    """(T,) int64, ascending."""
    samples: dict[str, Samples]
    dropped: dict[str, int]
    """By signal, the frames that are left out because of it."""
    held: dict[str, int]
    """By signal, the frames that use a stale value of it."""
    num_dropped: int
    num_held: int

    @property
    def num_candidates(self) -> int:
        """Frames before any were left out."""
        return len(self.frames_ns) + self.num_dropped


def latest_before(times_ns: np.ndarray, frames_ns: np.ndarray) -> np.ndarray:
    """For each frame the place of the newest time that is not after it, -1 where there is none.

    Args:
        times_ns: (n,) int64, ascending; of equal times the last counts.
        frames_ns: (T,) int64.
    """
    return np.searchsorted(times_ns, frames_ns, side="right") - 1


def frame_times(start_ns: int, stop_ns: int, hz: int) -> np.ndarray:
    """Frames at k / hz after the start, up to and including the stop; nothing accumulates."""
    if stop_ns < start_ns:
        return np.zeros(0, np.int64)
    count = (stop_ns - start_ns) * hz // 1_000_000_000 + 1
    return start_ns + (np.arange(count, dtype=np.int64) * 1_000_000_000 + hz // 2) // hz


def first_complete(signals: Mapping[str, SignalTimes], start_ns: int) -> int | None:
    """The first moment from `start_ns` on when every signal has a fresh message; None if never.

    Signals with the method `next` need none yet.
    """
    moment = start_ns
    while True:
        later = moment
        for signal in signals.values():
            if signal.method == "next":
                continue
            i = int(latest_before(signal.times_ns, np.array([moment]))[0])
            if i >= 0 and moment - int(signal.times_ns[i]) <= signal.max_age_ns:
                continue
            if i + 1 >= len(signal.times_ns):
                return None
            later = max(later, int(signal.times_ns[i + 1]))
        if later == moment:
            return moment
        moment = later


def plan_frames(
    signals: Mapping[str, SignalTimes], frames_ns: np.ndarray, *, hold: bool
) -> FramePlan:
    """Choose a message of every signal for every frame.

    Args:
        signals: By name.
        frames_ns: (T,) int64, ascending.
        hold: Keep a frame whose signal is stale with the old value; else leave the frame out. A
            frame before the first message of a signal is left out either way.
    """
    found = {name: _sample(signal, frames_ns) for name, signal in signals.items()}
    keep = np.ones(len(frames_ns), bool)
    stale_anywhere = np.zeros(len(frames_ns), bool)
    stale_of, dropped = {}, {}
    for name, signal in signals.items():
        samples = found[name]
        missing = samples.index < 0
        stale = ~missing & (samples.age_ns > signal.max_age_ns)
        bad = missing if hold else missing | stale
        dropped[name] = int(bad.sum())
        keep &= ~bad
        stale_of[name] = stale
        stale_anywhere |= stale
    kept = {
        name: Samples(s.index[keep], s.age_ns[keep], s.weight[keep]) for name, s in found.items()
    }
    return FramePlan(
        frames_ns[keep],
        kept,
        dropped,
        {name: int((stale & keep).sum()) for name, stale in stale_of.items()},
        int((~keep).sum()),
        int((stale_anywhere & keep).sum()),
    )


def _sample(signal: SignalTimes, frames_ns: np.ndarray) -> Samples:
    times = signal.times_ns
    asked = frames_ns
    if signal.method == "next" and len(frames_ns):
        # The last frame has no follower; its command is the newest within one more period.
        period = int(np.median(np.diff(frames_ns))) if len(frames_ns) > 1 else signal.max_age_ns
        asked = np.append(frames_ns[1:], frames_ns[-1] + period) - 1
    index = latest_before(times, asked)
    weight: np.ndarray = np.zeros(len(frames_ns))
    if not len(times):
        return Samples(index, np.zeros(len(frames_ns), np.int64), weight)
    here = times[np.maximum(index, 0)]
    age = np.where(index >= 0, frames_ns - here, 0)
    if signal.method == "linear":
        after = np.minimum(index + 1, len(times) - 1)
        gap = times[after] - here
        ahead = times[after] - frames_ns
        usable = (index >= 0) & (gap > 0) & (age <= signal.max_age_ns)
        usable &= ahead <= signal.max_age_ns
        weight = np.where(usable, age / np.maximum(gap, 1), 0.0)
    return Samples(index, age, weight)
