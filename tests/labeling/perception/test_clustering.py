from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codediffuser.datagen.task import get_task
from codediffuser.datagen.task_config import ClusterConfig
from codediffuser.errors import ConfigError, NotRegisteredError, ShapeError
from codediffuser.labeling.perception.clustering import (
    CLUSTERERS,
    NOISE,
    cluster_config,
    cluster_points,
    dbscan,
)

PITCH_M = 0.042
"""Between neighbouring slots of the crate."""


def slots(rng: np.random.Generator, per_slot: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Points on the floors of 3 x 4 slots, and the number of each point's slot."""
    centre = np.array([(x, y) for x in range(3) for y in range(4)]) * PITCH_M
    number = np.repeat(np.arange(12), per_slot)
    xy = centre[number] + rng.uniform(-0.012, 0.012, (len(number), 2))
    return np.column_stack([xy, np.zeros(len(number))]).astype(np.float32), number


@pytest.mark.parametrize("method", list(CLUSTERERS))
def test_slots_are_told_apart(method: str) -> None:
    points, number = slots(np.random.default_rng(0))
    found = cluster_points(points, ClusterConfig(eps_m=0.010), method=method)
    assert found.min() >= 0
    assert len(np.unique(found)) == 12
    assert len(set(zip(found.tolist(), number.tolist(), strict=True))) == 12
    centre = np.array([points[found == k, 0].mean() for k in range(12)])
    assert (np.diff(centre) > 0).all()  # counted along x


def test_the_papers_thresholds_in_metres_would_join_all_slots() -> None:
    points, _ = slots(np.random.default_rng(0))
    assert set(cluster_points(points, ClusterConfig(eps_m=0.1))) == {0}


@pytest.mark.parametrize("method", list(CLUSTERERS))
@pytest.mark.parametrize("seed", range(5))
def test_instances_do_not_depend_on_the_order_of_the_points(method: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Blobs that touch, strays, and coinciding points: all that an order could decide.
    blobs = [rng.normal(c, 0.008, (80, 3)) for c in rng.uniform(-0.06, 0.06, (6, 3))]
    points = np.concatenate([*blobs, rng.uniform(-0.1, 0.1, (60, 3)), blobs[0][:5]])
    config = ClusterConfig(eps_m=0.007, min_points=10)
    found = cluster_points(points, config, method=method)
    assert len(np.unique(found)) > 2
    shuffled = rng.permutation(len(points))
    again = cluster_points(points[shuffled], config, method=method)
    np.testing.assert_array_equal(again, found[shuffled])


@given(st.integers(0, 2**31), st.integers(1, 120), st.integers(1, 8))
@settings(max_examples=40, deadline=None)
def test_core_points_are_those_of_scikit_learn(seed: int, n: int, min_neighbours: int) -> None:
    from sklearn.cluster import DBSCAN

    points = np.random.default_rng(seed).uniform(0, 1, (n, 3))
    eps = 0.15
    found = dbscan(points, eps, min_neighbours)
    theirs = DBSCAN(eps=eps, min_samples=min_neighbours).fit(points)
    core = theirs.core_sample_indices_
    pairs = set(zip(found[core].tolist(), theirs.labels_[core].tolist(), strict=True))
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})
    assert NOISE not in {a for a, _ in pairs}
    np.testing.assert_array_equal(found == NOISE, theirs.labels_ == NOISE)


def test_a_border_point_goes_to_the_nearer_cluster() -> None:
    left = np.column_stack([np.linspace(-0.05, -0.01, 9), np.zeros(9), np.zeros(9)])
    right = np.column_stack([np.linspace(0.012, 0.052, 9), np.zeros(9), np.zeros(9)])
    middle = np.array([[0.0, 0.0, 0.0]])  # 10 mm from the left, 12 mm from the right
    for points in (np.concatenate([left, middle, right]), np.concatenate([right, middle, left])):
        found = cluster_points(points, ClusterConfig(eps_m=0.0125, min_neighbours=4, min_points=2))
        assert found[9] == found[np.argmin(points[:, 0])] == 0
        assert found.max() == 1


def test_small_clusters_are_dropped_by_number_and_by_share_of_the_median() -> None:
    rng = np.random.default_rng(0)
    sizes = [400, 60, 60, 11, 9]
    which = np.repeat(np.arange(5), sizes)
    points = rng.uniform(0, 0.01, (sum(sizes), 3))
    points[:, 0] += 0.1 * which

    def kept(min_points: int, min_share: float) -> list[int]:
        config = ClusterConfig(eps_m=0.02, min_points=min_points, min_share=min_share)
        return np.unique(which[cluster_points(points, config) != NOISE]).tolist()

    assert kept(10, 0.0) == [0, 1, 2, 3]
    # The median is 60: 11 are too few. A share of the largest would have dropped all the others.
    assert kept(10, 0.2) == [0, 1, 2]
    assert kept(1000, 0.0) == []


@pytest.mark.parametrize("method", list(CLUSTERERS))
@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_points_are_no_instance(method: str, n: int) -> None:
    found = cluster_points(np.zeros((n, 3)), ClusterConfig(eps_m=0.01), method=method)
    assert found.tolist() == [NOISE] * n


def test_what_is_no_cloud_and_unknown_methods_are_refused() -> None:
    config = ClusterConfig(eps_m=0.01)
    with pytest.raises(ShapeError):
        cluster_points(np.zeros((3, 2)), config)
    with pytest.raises(NotRegisteredError, match="Did you mean 'dbscan'"):
        cluster_points(np.zeros((3, 3)), config, method="dbscn")


@pytest.mark.parametrize("name", ["hang_mug", "pack_battery", "stow_book"])
def test_every_task_says_the_sizes_of_its_categories(name: str) -> None:
    task = get_task(name)
    clusters = task.config.labeling.clusters
    for category in (task.pick_category, task.place_category):
        assert 0.002 < cluster_config(clusters, category).eps_m < PITCH_M / 2
    with pytest.raises(ConfigError, match="no `labeling: clusters: spoon:`"):
        cluster_config(clusters, "spoon")
