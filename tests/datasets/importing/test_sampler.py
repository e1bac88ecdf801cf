"""The law of the import: no frame takes a message from its future."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from codediffuser.datasets.importing.sampler import (
    SignalTimes,
    first_complete,
    frame_times,
    latest_before,
    plan_frames,
)

times = hnp.arrays(np.int64, st.integers(0, 40), elements=st.integers(0, 1000)).map(np.sort)
frames = hnp.arrays(np.int64, st.integers(0, 40), elements=st.integers(-10, 1010)).map(np.unique)
signals = st.dictionaries(
    st.sampled_from("abcd"),
    st.builds(SignalTimes, times, st.integers(0, 300), st.sampled_from(["latest", "linear"])),
    min_size=1,
)


@given(times, frames)
def test_the_latest_message_is_not_after_its_frame_and_none_lies_between(t, f):
    index = latest_before(t, f)
    for k, i in enumerate(index):
        assert i < 0 or t[i] <= f[k]
        assert not ((t > (t[i] if i >= 0 else -np.inf)) & (t <= f[k])).any()


@given(signals, frames, st.booleans())
def test_no_frame_takes_a_message_from_its_future(given_signals, f, hold):
    plan = plan_frames(given_signals, f, hold=hold)
    for name, samples in plan.samples.items():
        taken = given_signals[name].times_ns[samples.index]
        assert (taken <= plan.frames_ns).all()
        assert (samples.age_ns == plan.frames_ns - taken).all()


@given(signals, frames)
def test_dropping_leaves_no_stale_value(given_signals, f):
    plan = plan_frames(given_signals, f, hold=False)
    for name, samples in plan.samples.items():
        assert (samples.age_ns <= given_signals[name].max_age_ns).all()
    assert plan.num_held == 0


@given(signals, frames, st.booleans())
def test_every_frame_is_kept_or_counted(given_signals, f, hold):
    plan = plan_frames(given_signals, f, hold=hold)
    assert plan.num_candidates == len(f)
    assert np.isin(plan.frames_ns, f).all()
    assert plan.num_dropped <= sum(plan.dropped.values())
    assert plan.num_held <= sum(plan.held.values())


@given(signals, frames)
def test_messages_of_the_future_change_nothing(given_signals, f):
    """What comes after a frame could just as well not exist, unless numbers are interpolated."""
    causal = {n: SignalTimes(s.times_ns, s.max_age_ns, "latest") for n, s in given_signals.items()}
    whole = plan_frames(causal, f, hold=False)
    for k, frame in enumerate(whole.frames_ns):
        seen = {
            n: SignalTimes(s.times_ns[s.times_ns <= frame], s.max_age_ns) for n, s in causal.items()
        }
        alone = plan_frames(seen, np.array([frame]), hold=False)
        for name in causal:
            assert alone.samples[name].index[0] == whole.samples[name].index[k]


@given(signals, frames)
def test_interpolation_stays_between_fresh_neighbours(given_signals, f):
    plan = plan_frames(given_signals, f, hold=True)
    for name, samples in plan.samples.items():
        signal = given_signals[name]
        assert ((samples.weight >= 0) & (samples.weight < 1)).all()
        if signal.method == "latest":
            assert (samples.weight == 0).all()
        for k in np.flatnonzero(samples.weight):
            before, after = signal.times_ns[samples.index[k] : samples.index[k] + 2]
            assert before <= plan.frames_ns[k] < after
            assert after - plan.frames_ns[k] <= signal.max_age_ns
            mixed = before + samples.weight[k] * (after - before)
            assert abs(mixed - plan.frames_ns[k]) < 1e-6


def test_a_command_of_the_following_frame_is_older_than_that_frame():
    signal = SignalTimes(np.array([0, 9, 10, 19]), 100, "next")
    plan = plan_frames({"action": signal}, np.array([0, 10, 20]), hold=False)
    assert plan.samples["action"].index.tolist() == [1, 3, 3]


@given(signals, st.integers(0, 1000))
def test_the_first_complete_moment_is_one_that_drops_nothing(given_signals, start):
    moment = first_complete(given_signals, start)
    if moment is None:
        later = np.arange(start, 1400)
        assert len(plan_frames(given_signals, later, hold=False).frames_ns) == 0
        return
    assert moment >= start
    between = plan_frames(given_signals, np.arange(start, moment + 1), hold=False)
    assert between.frames_ns.tolist() == [moment]


def test_frames_at_a_fixed_rate_do_not_drift():
    t = frame_times(5, 5 + 3600 * 10**9, 30)
    assert len(t) == 3600 * 30 + 1
    assert t[-1] == 5 + 3600 * 10**9
    assert set(np.diff(t).tolist()) == {33333333, 33333334}


def test_no_frames_come_before_the_start():
    assert len(frame_times(10, 9, 30)) == 0
