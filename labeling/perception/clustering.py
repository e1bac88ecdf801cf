"""Points of one category to instances: clusters that do not depend on the order of the points.

Points are put into one order before they are clustered, and clusters are numbered by where they
are, so the same set of points gives the same instances whatever order the cameras come in.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from codediffuser.datagen.task_config import ClusterConfig
from codediffuser.errors import ConfigError
from codediffuser.pointcloud import check_points
from codediffuser.registry import Registry

NOISE = -1
"""Number of points that belong to no cluster."""


class Clusterer(Protocol):
    """One way to find clusters."""

    def __call__(self, points: np.ndarray, eps_m: float, min_neighbours: int) -> np.ndarray:
        """Number the clusters of points (N, 3), N >= 1: (N,) int64 from 0, `NOISE` for none.

        Args:
            points: Metres, in lexicographic order; points may coincide.
            eps_m: Points this near are neighbours.
            min_neighbours: A core point has at least that many neighbours, itself included.
        """


CLUSTERERS: Registry[Clusterer] = Registry("clustering method")


def cluster_points(
    points: np.ndarray, config: ClusterConfig, *, method: str = "dbscan"
) -> np.ndarray:
    """Find the instances among points of one category.

    A cluster is dropped when it has fewer points than `config.min_points`, or fewer than
    `config.min_share` of those of the median cluster that has enough: fragments of one thing that
    show behind another are no instances, and one large cluster does not make the others small.

    Args:
        points: (N, 3) float, metres; N may be 0.
        config: Sizes of the category, from the task's YAML.
        method: Name in `CLUSTERERS`.

    Returns:
        instance: (N,) int64, `NOISE` or the number of the instance, from 0 in lexicographic order
        of the centroids. The same point has the same number in any order of the points.

    Raises:
        NotRegisteredError: No such method.
        ShapeError: The points are not (N, 3).
    """
    check_points(points)
    clusterer = CLUSTERERS.get(method)
    instance = np.full(len(points), NOISE, dtype=np.int64)
    if len(points) == 0:
        return instance
    order = np.lexsort(points.T[::-1])
    ordered = points[order].astype(np.float64)
    found = clusterer(ordered, config.eps_m, config.min_neighbours)
    instance[order] = _numbered_by_place(ordered, found, config)
    return instance


def cluster_config(clusters: dict[str, ClusterConfig], category: str) -> ClusterConfig:
    """The sizes of one category of a task.

    Raises:
        ConfigError: The task's YAML says nothing of the category.
    """
    if category not in clusters:
        raise ConfigError(
            f"the task's YAML has no `labeling: clusters: {category}:`; it has "
            f"{', '.join(sorted(clusters)) or 'none'}; add the category with its eps_m"
        )
    return clusters[category]


@CLUSTERERS.add("dbscan")
def dbscan(points: np.ndarray, eps_m: float, min_neighbours: int) -> np.ndarray:
    """DBSCAN by one search tree, where a border point goes to its nearest core point.

    In the original, and in scikit-learn's and Open3D's, a border point goes to the cluster that
    was found first; here the order decides nothing. Otherwise the clusters are the same. Memory
    grows with the number of neighbour pairs.

    Source: Ester et al., A Density-Based Algorithm for Discovering Clusters, KDD 1996.
    """
    pairs = cKDTree(points).query_pairs(eps_m, output_type="ndarray")
    core = 1 + np.bincount(pairs.ravel(), minlength=len(points)) >= min_neighbours
    number = np.full(len(points), NOISE, dtype=np.int64)
    if not core.any():
        return number
    ends = core[pairs]
    inner = pairs[ends.all(axis=1)]
    graph = coo_array((np.ones(len(inner), bool), inner.T), shape=(len(points), len(points)))
    _, component = connected_components(graph, directed=False)
    _, number[core] = np.unique(component[core], return_inverse=True)
    border, nearest_core = _nearest_core(points, pairs[ends[:, 0] != ends[:, 1]], core)
    number[border] = number[nearest_core]
    return number


@CLUSTERERS.add("hdbscan")
def hdbscan(points: np.ndarray, eps_m: float, min_neighbours: int) -> np.ndarray:
    """HDBSCAN of scikit-learn: densities may differ; clusters nearer than `eps_m` are not parted.

    Source: Campello et al., Density-Based Clustering Based on Hierarchical Density Estimates,
    PAKDD 2013; Malzer and Baum, A Hybrid Approach to Hierarchical Density-based Cluster Selection,
    MFI 2020.
    """
    from sklearn.cluster import HDBSCAN

    if len(points) < max(2, min_neighbours):
        return np.full(len(points), NOISE, dtype=np.int64)
    model = HDBSCAN(
        min_cluster_size=max(2, min_neighbours),
        min_samples=min_neighbours,
        cluster_selection_epsilon=eps_m,
        allow_single_cluster=True,
        copy=True,
    )
    return np.asarray(model.fit_predict(points), dtype=np.int64)


def _nearest_core(
    points: np.ndarray, pairs: np.ndarray, core: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Border points and the core point nearest to each, from pairs of one core and one border."""
    first_is_core = core[pairs[:, 0]]
    border = np.where(first_is_core, pairs[:, 1], pairs[:, 0])
    inside = np.where(first_is_core, pairs[:, 0], pairs[:, 1])
    distance = np.linalg.norm(points[border] - points[inside], axis=1)
    order = np.lexsort((inside, distance, border))
    border, first = np.unique(border[order], return_index=True)
    return border, inside[order][first]


def _numbered_by_place(points: np.ndarray, found: np.ndarray, config: ClusterConfig) -> np.ndarray:
    """Drop small clusters and number the others by their centroids."""
    instance = np.full(len(points), NOISE, dtype=np.int64)
    sizes = np.bincount(found[found != NOISE])
    enough = np.flatnonzero(sizes >= config.min_points)
    if len(enough) == 0:
        return instance
    kept = enough[sizes[enough] >= config.min_share * np.median(sizes[enough])]
    centroids = np.array([points[found == number].mean(axis=0) for number in kept])
    for new, place in enumerate(np.lexsort(centroids.T[::-1])):
        instance[found == kept[place]] = new
    return instance
