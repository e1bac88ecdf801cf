"""Brings the signals of one episode of a bag to its frames, and reports how that went."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.episode_format import SyncRecord, TopicSync
from codediffuser.datasets.importing.bag_transforms import read_tree, tree_cameras
from codediffuser.datasets.importing.config import Clock, ImportConfig
from codediffuser.datasets.importing.faults import Arrivals, examine_arrivals
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.sampler import (
    FramePlan,
    SignalTimes,
    first_complete,
    frame_times,
    plan_frames,
)
from codediffuser.datasets.importing.segments import Segment
from codediffuser.datasets.importing.signals import (
    Signal,
    describe_action,
    signals_of,
    tree_frames,
)
from codediffuser.datasets.importing.topic_times import TopicTimes, read_times
from codediffuser.datasets.importing.transforms import TransformTree
from codediffuser.errors import DatasetError

RATE_TOLERANCE = 0.05
"""How far the rate of a reference topic may be from `hz`."""


@dataclass(frozen=True, slots=True)
class SyncedEpisode:
    """Frames of one episode, and which message each of them takes."""

    signals: list[Signal]
    index: dict[str, np.ndarray]
    """By signal (n,) int64: places in the recording of the times that the plan speaks of."""
    times_ns: dict[str, np.ndarray]
    """By signal (n,) int64: those times, ascending."""
    plan: FramePlan
    tree: TransformTree
    record: SyncRecord
    missing_share: dict[str, float]
    """By topic."""
    damage: list[str]

    def arrays(self) -> dict[str, np.ndarray]:
        """What `sync.npz` holds: `frame_ns` and, by signal, the time of the message taken (T,)."""
        taken = {name: self.times_ns[name][s.index] for name, s in self.plan.samples.items()}
        return {"frame_ns": self.plan.frames_ns, **taken}


def synchronise(recording: Recording, segment: Segment, config: ImportConfig) -> SyncedEpisode:
    """Choose the frames of an episode and a message of every signal for each of them.

    Raises:
        DatasetError: A topic is missing, or the signals never meet.
    """
    signals = signals_of(config)
    for signal in signals:
        recording.topic(signal.topic, signal.name)
    oldest = max([s.max_age_ns for s in signals], default=0)
    start, stop = segment.start_ns - oldest, segment.stop_ns
    topics: dict[str, TopicTimes] = {}
    damage: list[str] = []
    for name in dict.fromkeys([*(s.topic for s in signals), config.sync.reference]):
        if name:
            recording.topic(name, "sync.reference")
            topics[name], found = read_times(recording, name, start, stop)
            damage += found
    clock, shift = config.sync.clock, _shift(topics, config.sync.clock)
    tree = read_tree(recording, start, stop, clock, damage)
    times, index, used = {}, {}, {}
    for s in signals:
        times[s.name], index[s.name], used[s.name] = topics[s.topic].on(clock, shift)
    sampled = {s.name: SignalTimes(times[s.name], s.max_age_ns, s.method) for s in signals}
    for name, edge_times, age in _tree_signals(tree, config):
        sampled[name] = SignalTimes(edge_times, age)
        times[name] = edge_times
    frames = _frames(topics, sampled, segment, config, shift)
    plan = plan_frames(sampled, frames, hold=config.sync.on_stale == "hold")
    arrivals = {
        name: _examine(topic, segment, recording.span_ns[0], by_header=clock == "header")
        for name, topic in topics.items()
    }
    return SyncedEpisode(
        signals, index, times, plan, tree,
        _record(config, signals, plan, arrivals, used),
        {name: a.missing_share for name, a in arrivals.items()},
        damage,
    )  # fmt: skip


def _shift(topics: dict[str, TopicTimes], clock: Clock) -> int:
    """Between the senders' clock and the bag's; 0 on the bag's own."""
    shifts = [t.shift_ns for t in topics.values() if t.header_ns is not None]
    return int(np.median(shifts)) if shifts and clock == "header" else 0


def _tree_signals(tree: TransformTree, config: ImportConfig) -> list[tuple[str, np.ndarray, int]]:
    """Name, times and greatest age of every moving transform that frames need."""
    wanted = [*tree_frames(config).values(), *tree_cameras(config)]
    found: dict[str, tuple[np.ndarray, int]] = {}
    for frame, age in wanted:
        for child, edge in tree.edges(config.world_frame, frame).items():
            known = found.get(child)
            found[child] = (edge.times_ns, min(age, known[1]) if known else age)
    return [(f"tf.{child}", t, age) for child, (t, age) in found.items()]


def _frames(
    topics: dict[str, TopicTimes],
    sampled: dict[str, SignalTimes],
    segment: Segment,
    config: ImportConfig,
    shift: int,
) -> np.ndarray:
    """Candidate frames (T,) int64, ascending, from the first moment when all signals are there."""
    start, stop = segment.start_ns - shift, segment.stop_ns - shift
    silent = [n for n, s in sampled.items() if not len(s.times_ns) and s.method != "next"]
    if silent:
        raise DatasetError(f"no messages of {', '.join(silent)} within the episode")
    first = first_complete(sampled, start)
    if first is None or first > stop:
        raise DatasetError("the signals never are there together, each fresh enough")
    if not config.sync.reference:
        return frame_times(first, stop, config.hz)
    times, _, _ = topics[config.sync.reference].on(config.sync.clock, shift)
    frames = np.unique(times[(times >= first) & (times <= stop)])
    if len(frames) > 1:
        rate = 1e9 / float(np.median(np.diff(frames)))
        if abs(rate / config.hz - 1) > RATE_TOLERANCE:
            raise DatasetError(
                f"the reference topic '{config.sync.reference}' runs at {rate:.2f} Hz, hz says "
                f"{config.hz}; set hz to its rate, or take frames at a fixed rate"
            )
    return frames


def _examine(topic: TopicTimes, segment: Segment, origin: int, *, by_header: bool) -> Arrivals:
    inside = topic.bag_ns >= segment.start_ns
    header = None if topic.header_ns is None else topic.header_ns[inside]
    return examine_arrivals(topic.bag_ns[inside], header, origin, by_header=by_header)


def _record(
    config: ImportConfig,
    signals: list[Signal],
    plan: FramePlan,
    arrivals: dict[str, Arrivals],
    used: dict[str, Clock],
) -> SyncRecord:
    records = {s.name: _topic_sync(s.topic, s.method, s.name, plan, used[s.name],
                                   arrivals[s.topic]) for s in signals}  # fmt: skip
    nothing = Arrivals(0, 0.0, 0.0, 0, 0, 0, 0, ())
    for name in plan.samples:
        if name not in records:
            clock = config.sync.clock
            records[name] = _topic_sync("tf", "latest", name, plan, clock, nothing)
    return SyncRecord(
        clock=config.sync.clock,
        reference=config.sync.reference,
        max_age_ms=config.sync.max_age_s * 1000,
        on_stale=config.sync.on_stale,
        action=describe_action(config),
        dropped_frames=plan.num_dropped,
        held_frames=plan.num_held,
        signals=records,
    )


def _topic_sync(
    topic: str, method: str, name: str, plan: FramePlan, clock: Clock, arrivals: Arrivals
) -> TopicSync:
    age_ms = np.abs(plan.samples[name].age_ns) / 1e6
    p50, p95 = np.percentile(age_ms, [50, 95]) if len(age_ms) else (0.0, 0.0)
    return TopicSync.model_validate(
        {
            "topic": topic,
            "method": method,
            "clock": clock,
            "messages": arrivals.messages,
            "rate_hz": round(arrivals.rate_hz, 3),
            "skew_p50_ms": round(float(p50), 3),
            "skew_p95_ms": round(float(p95), 3),
            "skew_max_ms": round(float(age_ms.max()) if len(age_ms) else 0.0, 3),
            "jitter_p95_ms": round(arrivals.jitter_p95_ms, 3),
            "missing": arrivals.missing,
            "late": arrivals.late,
            "reordered": arrivals.reordered,
            "duplicates": arrivals.duplicates,
            "held_frames": plan.held[name],
            "dropped_frames": plan.dropped[name],
            "faults": arrivals.faults,
        }
    )
