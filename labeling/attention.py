"""Attention on a cloud at any frame: labelled points of frame 0, carried by how their object moves.

Propagation is parameters, never copies: a label keeps its points at frame 0 and the id of what it
follows. A cloud of a later frame is taken back to frame 0 by the motion of that object and compared
with the labelled points there, so one search tree serves a whole episode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from codediffuser.errors import LabelError, ShapeError
from codediffuser.labeling.label import ROLES, AttentionLabel
from codediffuser.pointcloud import check_points, inside_box
from codediffuser.poses import apply_transform, invert_transform

RADIUS_M = 0.005
"""Points this near to a labelled point share its attention."""

Poses = Mapping[str, np.ndarray]
"""Pose (4, 4) float64 in the world of each followed object, by id."""


class AttentionField:
    """Where attention lies in one episode, as a function of where its objects are.

    Args:
        labels: Targets of the episode, any order; two labels of one role are joined.
        T_world_start: Poses at frame 0 of the objects that labels follow; others are ignored.
        radius_m: How far from a labelled point attention reaches. Larger than the spacing of
            readings of several cameras, smaller than the gap to what stands beside.

    Raises:
        LabelError: A label follows an object with no pose, or has no points.
    """

    def __init__(
        self, labels: Sequence[AttentionLabel], T_world_start: Poses, *, radius_m: float = RADIUS_M
    ) -> None:
        self.labels = tuple(labels)
        self.radius_m = radius_m
        self._T_start = {f: _pose(T_world_start, f, "at frame 0") for f in self.followed}
        self._trees = []
        for label in self.labels:
            check_points(label.points_world, f"points of the {label.role} label")
            if len(label.points_world) == 0:
                raise LabelError(
                    f"the {label.role} label of '{label.instance_id}' has no points; label it again"
                )
            self._trees.append(cKDTree(label.points_world))

    @property
    def followed(self) -> tuple[str, ...]:
        """Ids of the objects whose poses `at` needs, sorted."""
        return tuple(sorted({label.follows for label in self.labels if label.follows is not None}))

    def at(self, points_world: np.ndarray, T_world_now: Poses) -> np.ndarray:
        """Attention of a cloud while the followed objects stand at `T_world_now`.

        Args:
            points_world: (N, 3) float32, metres; N may be 0.
            T_world_now: Poses of at least the `followed` objects.

        Returns:
            attention: (N, 2) float32, 0 or 1, one channel per role in the order of `ROLES`.

        Raises:
            LabelError: A followed object has no pose now.
            ShapeError: `points_world` is not (N, 3).
        """
        check_points(points_world, "points_world")
        attention = np.zeros((len(points_world), len(ROLES)), dtype=np.float32)
        if len(points_world) == 0:
            return attention
        for label, tree in zip(self.labels, self._trees, strict=True):
            points = points_world
            if label.follows is not None:
                T_now_start = self._motion(label.follows, T_world_now)
                points = apply_transform(invert_transform(T_now_start), points)
            near = np.flatnonzero(
                inside_box(points, tree.mins - self.radius_m, tree.maxes + self.radius_m)
            )
            distance, _ = tree.query(points[near], distance_upper_bound=self.radius_m)
            attention[near[np.isfinite(distance)], ROLES.index(label.role)] = 1.0
        return attention

    def carried(self, T_world_now: Poses) -> tuple[np.ndarray, np.ndarray]:
        """The labelled points themselves, where their objects have taken them.

        Returns:
            points_world: (M, 3) float32, metres: all points of all labels.
            attention: (M, 2) float32, one channel per role in the order of `ROLES`.

        Raises:
            LabelError: A followed object has no pose now.
        """
        clouds, channels = [np.zeros((0, 3), np.float32)], [np.zeros((0, len(ROLES)), np.float32)]
        for label in self.labels:
            points = label.points_world
            if label.follows is not None:
                points = apply_transform(self._motion(label.follows, T_world_now), points)
            channel = np.zeros((len(points), len(ROLES)), dtype=np.float32)
            channel[:, ROLES.index(label.role)] = 1.0
            clouds.append(points)
            channels.append(channel)
        return np.concatenate(clouds), np.concatenate(channels)

    def _motion(self, object_id: str, T_world_now: Poses) -> np.ndarray:
        """What takes points of an object at frame 0 to where they are now, (4, 4)."""
        T_world_object = _pose(T_world_now, object_id, "now")
        return np.asarray(T_world_object @ invert_transform(self._T_start[object_id]))


def attention_at(
    points_world: np.ndarray,
    labels: Sequence[AttentionLabel],
    T_world_start: Poses,
    T_world_now: Poses,
    *,
    radius_m: float = RADIUS_M,
) -> np.ndarray:
    """Attention (N, 2) of a single cloud; see `AttentionField` for many frames of one episode."""
    return AttentionField(labels, T_world_start, radius_m=radius_m).at(points_world, T_world_now)


def clean_attention(
    points: np.ndarray,
    attention: np.ndarray,
    *,
    eps_m: float = 0.012,
    min_neighbours: int = 4,
    min_share: float = 0.2,
) -> np.ndarray:
    """Keep the largest clusters of each channel and drop attention from strays.

    A policy that never saw a stray point fails on a few of them, so masks are cleaned before it.
    Clusters are those of DBSCAN, but a point at the edge of two clusters belongs to both, which
    makes cleaning twice the same as cleaning once.

    Args:
        points: (N, 3) float, metres.
        attention: (N, C) float in [0, 1].
        eps_m: Points this near are neighbours. Above the spacing of readings.
        min_neighbours: A core point has at least that many attended neighbours, itself included.
        min_share: Clusters with fewer core points than this share of the largest are strays; 1
            keeps the largest alone. A target may be seen in pieces: floor and walls of a slot.

    Returns:
        attention: (N, C), a copy with zeros where a stray was. A channel without any core point
        is returned as it came: a very sparse mask is better than none.

    Raises:
        ShapeError: The two arrays do not fit together.

    Source: Ester et al., A Density-Based Algorithm for Discovering Clusters, KDD 1996.
    """
    check_points(points)
    if attention.ndim != 2 or len(attention) != len(points):
        raise ShapeError(
            f"attention: expected shape ({len(points)}, C) to fit the points, got {attention.shape}"
        )
    cleaned = attention.copy()
    for channel in range(attention.shape[1]):
        attended = np.flatnonzero(attention[:, channel] > 0)
        keep = _large_clusters(points[attended], eps_m, min_neighbours, min_share)
        cleaned[attended[~keep], channel] = 0.0
    return cleaned


def corrupt_attention(
    attention: np.ndarray, rng: np.random.Generator, share: float = 0.15
) -> np.ndarray:
    """Swap a share of the attended points of each channel for wrong ones (stress test).

    Attended points lose their attention and as many points that had none gain it, so a channel
    keeps its number of attended points while there are enough others.

    Args:
        attention: (N, C) float in [0, 1].
        rng: Chooses the points.
        share: Part of the attended points that is swapped, in [0, 1].

    Returns:
        attention: (N, C), a copy.
    """
    corrupted = attention.copy()
    for channel in range(attention.shape[1]):
        attended = np.flatnonzero(attention[:, channel] > 0)
        others = np.flatnonzero(attention[:, channel] <= 0)
        count = round(share * len(attended))
        lost = rng.choice(attended, size=count, replace=False)
        gained = rng.choice(others, size=min(count, len(others)), replace=False)
        corrupted[lost, channel] = 0.0
        corrupted[gained, channel] = 1.0
    return corrupted


def _pose(poses: Poses, object_id: str, when: str) -> np.ndarray:
    if object_id not in poses:
        raise LabelError(
            f"a label follows '{object_id}', which has no pose {when}; "
            f"poses are there for: {', '.join(sorted(poses)) or 'nothing'}"
        )
    return poses[object_id]


def _large_clusters(
    points: np.ndarray, eps_m: float, min_neighbours: int, min_share: float
) -> np.ndarray:
    """Which of the points (M, 3) belong to a cluster that is large enough, (M,) bool."""
    if len(points) == 0:
        return np.zeros(0, dtype=bool)
    pairs = cKDTree(points).query_pairs(eps_m, output_type="ndarray")
    degree = 1 + np.bincount(pairs.ravel(), minlength=len(points))
    core = degree >= min_neighbours
    if not core.any():
        return np.ones(len(points), dtype=bool)
    cluster = _components(pairs[core[pairs].all(axis=1)], len(points))
    size = np.bincount(cluster[core], minlength=len(points))
    keep = core & (size[cluster] >= min_share * size.max())
    if min_share >= 1.0:
        # Of equally large clusters, the one with the first point.
        keep = core & (cluster == cluster[np.flatnonzero(keep)[0]])
    member = keep.copy()
    for a, b in ((0, 1), (1, 0)):
        member[pairs[keep[pairs[:, a]], b]] = True
    return np.asarray(member)


def _components(edges: np.ndarray, count: int) -> np.ndarray:
    """Number of the connected component of each of `count` nodes, (count,) int."""
    weights = np.ones(len(edges), dtype=bool)
    graph = coo_array((weights, (edges[:, 0], edges[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])
