"""Facts about rates, intervals and paired comparison."""

import math

import pytest
from scipy.stats import binomtest

from codediffuser.errors import ConfigError
from codediffuser.eval.metrics import (
    Rate,
    compare_paired,
    count_failures,
    mcnemar_exact,
    rate,
    rates_by,
    wilson_interval,
)


@pytest.mark.parametrize("successes, trials", [(0, 5), (3, 7), (50, 60), (99, 100), (4, 4)])
def test_wilson_interval_agrees_with_scipy(successes, trials):
    expected = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high))


def test_wilson_interval_of_no_trials_knows_nothing():
    assert wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("trials", [1, 3, 60])
def test_wilson_interval_touches_the_ends_exactly(trials):
    assert wilson_interval(0, trials)[0] == 0.0
    assert wilson_interval(trials, trials)[1] == 1.0


def test_wilson_interval_narrows_with_more_trials():
    widths = [high - low for low, high in (wilson_interval(n // 2, n) for n in (10, 40, 160))]
    assert widths == sorted(widths, reverse=True)


def test_wilson_interval_refuses_more_successes_than_trials():
    with pytest.raises(ValueError, match=r"0\.\.3, got 4"):
        wilson_interval(4, 3)


def test_rate_reads_as_counts_share_and_interval():
    assert str(Rate(99, 100)) == "99/100 = 99.0% [94.6, 99.8] (95 % Wilson)"
    assert math.isnan(Rate(0, 0).share)
    assert str(Rate(0, 0)) == "0/0"


@pytest.mark.parametrize("only_a, only_b", [(0, 0), (1, 0), (0, 6), (10, 2), (5, 5)])
def test_mcnemar_exact_is_the_two_sided_binomial_test(only_a, only_b):
    n = only_a + only_b
    expected = binomtest(only_a, n).pvalue if n else 1.0
    assert mcnemar_exact(only_a, only_b) == pytest.approx(expected)


def test_compare_paired_counts_shared_scenes_only():
    a = {"0": True, "1": True, "2": False, "3": False, "only in a": True}
    b = {"0": True, "1": False, "2": True, "3": False, "only in b": True}
    compared = compare_paired(a, b)
    assert (compared.both, compared.only_a, compared.only_b, compared.neither) == (1, 1, 1, 1)
    assert compared.scenes == 4
    assert compared.difference == 0.0
    assert compared.p_value == 1.0


def test_compare_paired_is_antisymmetric_in_the_difference():
    a, b = {i: i != 3 for i in range(9)}, {i: i > 6 for i in range(9)}
    forth, back = compare_paired(a, b), compare_paired(b, a)
    assert forth.difference == -back.difference > 0
    assert forth.p_value == back.p_value < 0.1


def test_compare_paired_without_a_shared_scene_says_what_to_do():
    with pytest.raises(ConfigError, match=r"no scene in common.*--seed"):
        compare_paired({"a": True}, {"b": True})


def test_rates_by_keeps_groups_in_order_of_appearance():
    groups = rates_by([("b", True), ("a", False), ("b", False)])
    assert list(groups.items()) == [("b", Rate(1, 2)), ("a", Rate(0, 1))]


def test_rate_of_nothing_has_no_trials():
    assert rate([]) == Rate(0, 0)


def test_count_failures_lists_frequent_ones_first_and_no_success():
    counted = count_failures(["place:on_rim", None, "grasp:missed", "place:on_rim", None])
    assert list(counted.items()) == [("place:on_rim", 2), ("grasp:missed", 1)]
