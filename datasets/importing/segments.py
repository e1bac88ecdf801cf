"""Where the episodes of a bag start and stop: the whole, markers, gaps, or a list of times."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from codediffuser.datasets.importing.config import EpisodeCuts, ImportConfig, MarkerRule
from codediffuser.datasets.importing.decoding import Decoder
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.values import text_of
from codediffuser.errors import DatasetError

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Segment:
    """One episode of a recording, before its frames are looked at."""

    start_ns: int
    stop_ns: int
    success: bool
    refusal: str = ""
    """Why it is no episode; empty for one."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A marker that was recorded."""

    time_ns: int
    means: str


def cut_segments(recording: Recording, config: ImportConfig) -> list[Segment]:
    """Cut a recording into episodes, in the order of time.

    Raises:
        DatasetError: A topic that the cut needs is not recorded.
    """
    cuts, (first, last) = config.episodes, recording.span_ns
    if last <= first:
        return []
    if cuts.by == "whole":
        return [Segment(first, last, config.success)]
    if cuts.by == "times":
        return [
            Segment(first + int(a * 1e9), min(first + int(b * 1e9), last), config.success,
                    "" if a < b and first + int(a * 1e9) < last else "its times are not recorded")
            for a, b in cuts.times_s
        ]  # fmt: skip
    if cuts.by == "gaps":
        times = np.sort(recording.times_ns[_gap_topic(recording, config)])
        return [Segment(a, b, config.success) for a, b in split_at_gaps(times, cuts.gap_s)]
    return list(segments_of_marks(read_marks(recording, cuts), last, config.success))


def split_at_gaps(times_ns: np.ndarray, gap_s: float) -> list[tuple[int, int]]:
    """First and last time of each run of times without a longer silence."""
    if not len(times_ns):
        return []
    breaks = np.flatnonzero(np.diff(times_ns) > gap_s * 1e9)
    starts = np.append(0, breaks + 1)
    stops = np.append(breaks, len(times_ns) - 1)
    return [(int(times_ns[a]), int(times_ns[b])) for a, b in zip(starts, stops, strict=True)]


def segments_of_marks(marks: Sequence[Mark], last_ns: int, success: bool) -> Iterator[Segment]:
    """Turn markers into episodes.

    A start while an episode is open discards that one. An outcome after a stop judges the episode
    that was stopped, until the next start.
    """
    open_since: int | None = None
    closed: Segment | None = None
    for mark in marks:
        if mark.means == "start":
            if closed is not None:
                yield closed
                closed = None
            if open_since is not None:
                yield Segment(open_since, mark.time_ns, success, "started again before it stopped")
            open_since = mark.time_ns
            continue
        if open_since is not None:
            closed = Segment(open_since, mark.time_ns, success)
            open_since = None
        if closed is not None and mark.means in ("success", "failure"):
            closed = replace(closed, success=mark.means == "success")
        elif closed is not None and mark.means == "discard":
            closed = replace(closed, refusal="discarded by a marker")
    if closed is not None:
        yield closed
    if open_since is not None:
        yield Segment(open_since, last_ns, success, "the recording ends before it was stopped")


def read_marks(recording: Recording, cuts: EpisodeCuts) -> list[Mark]:
    """All markers in the order of bag time.

    Raises:
        DatasetError: No topic of a start marker is recorded.
    """
    rules: dict[str, list[MarkerRule]] = {}
    for rule in cuts.markers:
        rules.setdefault(rule.topic, []).append(rule)
    marks = []
    for name, of_topic in rules.items():
        if name not in recording.topics:
            if any(rule.means == "start" for rule in of_topic):
                recording.topic(name, "episodes.markers")
            continue
        decoder = Decoder(recording.topics[name])
        for i, time_ns in enumerate(recording.times_ns[name]):
            text = _text(recording, decoder, name, i)
            means = next(
                (r.means for r in of_topic if text is not None and r.value in (None, text)), None
            )
            if means is not None:
                marks.append(Mark(int(time_ns), means))
    return sorted(marks, key=lambda mark: mark.time_ns)


def _text(recording: Recording, decoder: Decoder, topic: str, index: int) -> str | None:
    try:
        return text_of(decoder.decode(recording.read(topic, index)))
    except DatasetError as error:
        _log.warning("%s: a marker is left out: %s", recording.path, error)
        return None


def _gap_topic(recording: Recording, config: ImportConfig) -> str:
    name = config.episodes.gap_topic or config.sync.reference
    if not name:
        if not config.cameras:
            raise DatasetError("episodes.gap_topic: name a topic, there is no camera to go by")
        name = next(iter(config.cameras.values())).color
    recording.topic(name, "episodes.gap_topic")
    return name
