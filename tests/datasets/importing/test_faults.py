"""Each injected fault is named, with its place; a healthy topic has none."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from codediffuser.datasets.importing.faults import examine_arrivals

PERIOD = 10_000_000


def healthy(n=100, latency=1_000_000):
    stamps = np.arange(n, dtype=np.int64) * PERIOD
    return stamps + latency, stamps


def test_a_healthy_topic_has_no_fault():
    bag, stamps = healthy()
    found = examine_arrivals(bag, stamps, 0, by_header=True)
    assert (found.missing, found.late, found.reordered, found.duplicates) == (0, 0, 0, 0)
    assert found.faults == () and found.jitter_p95_ms == 0
    assert abs(found.rate_hz - 100) < 1e-6


@given(st.sets(st.integers(1, 98), max_size=30))
def test_every_dropped_message_is_counted(dropped):
    bag, stamps = healthy()
    keep = np.array([i for i in range(100) if i not in dropped])
    assert examine_arrivals(bag[keep], stamps[keep], 0, by_header=True).missing == len(dropped)


@given(st.sets(st.integers(1, 98), max_size=10))
def test_every_late_message_is_counted(late):
    bag, stamps = healthy()
    for i in late:
        bag[i] += 3 * PERIOD + 1000
    order = np.argsort(bag, kind="stable")
    found = examine_arrivals(bag[order], stamps[order], 0, by_header=True)
    assert (found.late, found.missing) == (len(late), 0)


def test_a_message_that_was_overtaken_is_out_of_order():
    bag, stamps = healthy()
    bag[50] = bag[51] + 1
    order = np.argsort(bag, kind="stable")
    found = examine_arrivals(bag[order], stamps[order], 0, by_header=True)
    assert found.reordered == 1
    assert any(text.startswith("out of order at 0.511") for text in found.faults)


def test_a_stamp_that_comes_twice_is_a_duplicate_and_not_out_of_order():
    bag, stamps = healthy()
    stamps[50] = stamps[49]
    found = examine_arrivals(bag, stamps, 0, by_header=True)
    assert (found.duplicates, found.reordered) == (1, 0)


def test_jitter_is_that_of_the_clock_in_use():
    bag, stamps = healthy(1000)
    noisy = bag + np.random.default_rng(0).integers(-3_000_000, 3_000_000, 1000)
    assert examine_arrivals(noisy, stamps, 0, by_header=True).jitter_p95_ms == 0
    assert examine_arrivals(noisy, stamps, 0, by_header=False).jitter_p95_ms > 2


def test_without_stamps_gaps_are_still_told():
    bag, _ = healthy()
    found = examine_arrivals(np.delete(bag, [10, 11]), None, 0, by_header=False)
    assert (found.missing, found.late) == (2, 0)
    assert found.faults == ("2 missing at 0.091 s",)


def test_one_message_has_no_rate():
    found = examine_arrivals(np.array([5]), None, 0, by_header=False)
    assert (found.rate_hz, found.missing, found.messages) == (0.0, 0, 1)
