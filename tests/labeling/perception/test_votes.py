from __future__ import annotations

import numpy as np
import pytest

from codediffuser.errors import ShapeError
from codediffuser.labeling.perception.clustering import NOISE
from codediffuser.labeling.perception.votes import gather_votes

MIDDLES = np.array([[0.0, 0.0, 0.1], [0.021, 0.0, 0.1], [0.042, 0.0, 0.1]])
"""As far apart as the middles of the thinnest books."""


def votes(counts: tuple[int, ...], spread_m: float = 0.002) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    truth = np.repeat(np.arange(len(counts)), counts)
    cloud = MIDDLES[truth] + rng.normal(0, spread_m, (len(truth), 3))
    order = rng.permutation(len(truth))
    return cloud[order], truth[order]


def test_things_that_touch_are_parted_by_their_middles() -> None:
    cloud, truth = votes((400, 300, 500))
    instance, middles = gather_votes(cloud, 0.009, 20, 0.2)
    np.testing.assert_allclose(middles, MIDDLES, atol=0.001)
    np.testing.assert_array_equal(instance, truth)


def test_votes_between_two_middles_join_neither_into_one() -> None:
    cloud, _ = votes((400, 400, 400))
    bridge = np.linspace(MIDDLES[0], MIDDLES[1], 60)
    _, middles = gather_votes(np.concatenate([cloud, bridge]), 0.009, 20, 0.2)
    np.testing.assert_allclose(middles, MIDDLES, atol=0.0015)


def test_the_order_of_the_votes_changes_nothing() -> None:
    cloud, _ = votes((400, 300, 500))
    order = np.random.default_rng(1).permutation(len(cloud))
    instance, middles = gather_votes(cloud, 0.009, 20, 0.2)
    again, same = gather_votes(cloud[order], 0.009, 20, 0.2)
    np.testing.assert_allclose(same, middles, atol=1e-12)
    np.testing.assert_array_equal(again, instance[order])


def test_few_votes_are_no_instance() -> None:
    cloud, truth = votes((400, 12, 300))
    instance, middles = gather_votes(cloud, 0.009, 20, 0.0)
    assert len(middles) == 2
    assert set(instance[truth == 0]) == {0}


def test_far_votes_belong_to_nothing() -> None:
    cloud, _ = votes((400, 0, 0))
    stray = np.array([[0.3, 0.3, 0.3], [0.0, 0.0, 0.14]])
    instance, _ = gather_votes(np.concatenate([cloud, stray]), 0.009, 20, 0.2)
    np.testing.assert_array_equal(instance[-2:], NOISE)


def test_no_votes_are_no_instances() -> None:
    instance, middles = gather_votes(np.zeros((0, 3)), 0.009, 20, 0.2)
    assert instance.shape == (0,)
    assert middles.shape == (0, 3)


def test_votes_are_points() -> None:
    with pytest.raises(ShapeError, match="middles_world"):
        gather_votes(np.zeros((5, 2)), 0.009, 20, 0.2)
