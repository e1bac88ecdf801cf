"""Statistics are exact, and merging episodes is the same as taking all data at once."""

from __future__ import annotations

import numpy as np
import pytest

from codediffuser.datasets.stats import QUANTILES, feature_stats, merge_stats
from codediffuser.errors import ShapeError


def test_statistics_are_those_of_numpy() -> None:
    values = np.random.default_rng(0).normal(3.0, 2.0, (500, 4)).astype(np.float32)
    stats = feature_stats(values)
    exact = values.astype(np.float64)
    assert np.array_equal(stats["min"], exact.min(axis=0))
    assert np.array_equal(stats["max"], exact.max(axis=0))
    assert np.allclose(stats["mean"], exact.mean(axis=0), rtol=0, atol=1e-12)
    assert np.allclose(stats["std"], exact.std(axis=0), rtol=0, atol=1e-12)
    assert np.allclose(stats["q90"], np.quantile(exact, 0.9, axis=0))
    assert stats["count"].tolist() == [500]


def test_small_integers_do_not_overflow() -> None:
    stats = feature_stats(np.array([[200], [250]], dtype=np.uint8))
    assert stats["std"].tolist() == [25.0]


def test_merging_parts_of_unequal_length_equals_the_whole() -> None:
    rng = np.random.default_rng(1)
    parts = [rng.normal(i, 1 + i, (n, 3)) for i, n in enumerate((10, 70, 25))]
    whole = feature_stats(np.concatenate(parts))
    merged = merge_stats([feature_stats(part) for part in parts])
    for name in ("min", "max", "mean", "std", "count"):
        assert np.allclose(merged[name], whole[name], rtol=1e-12, atol=1e-12), name


def test_merged_statistics_are_those_of_lerobot() -> None:
    from lerobot.datasets.compute_stats import aggregate_feature_stats

    rng = np.random.default_rng(2)
    parts = [feature_stats(rng.normal(size=(n, 2))) for n in (4, 9)]
    ours, theirs = merge_stats(parts), aggregate_feature_stats(parts)
    assert set(ours) == set(theirs)
    for name in ours:
        assert np.allclose(ours[name], theirs[name]), name


def test_a_constant_column_has_no_spread() -> None:
    merged = merge_stats([feature_stats(np.full((n, 1), 0.04, np.float32)) for n in (3, 5)])
    assert merged["std"].tolist() == [0.0]


def test_points_are_counted_by_frames() -> None:
    stats = feature_stats(np.zeros((300, 5)), count=3)
    assert stats["count"].tolist() == [3] and stats["mean"].shape == (5,)


def test_every_statistic_of_lerobot_is_there() -> None:
    assert set(feature_stats(np.ones((1, 1)))) == {"min", "max", "mean", "std", "count", *QUANTILES}


@pytest.mark.parametrize("values", [np.zeros((0, 3)), np.zeros(4), np.zeros((2, 2, 2))])
def test_wrong_shapes_are_refused(values: np.ndarray) -> None:
    with pytest.raises(ShapeError, match=r"shape \(M, D\)"):
        feature_stats(values)


def test_nothing_cannot_be_merged() -> None:
    with pytest.raises(ShapeError, match="no statistics"):
        merge_stats([])
