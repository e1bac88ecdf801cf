"""Finds the instances of some categories in one set of views, by features alone.

Each reading in the workspace takes the category of its most similar reference, or none. Readings of
one category are then parted into instances: by the middles that they vote for where the backend
tells them, else by clusters of the points themselves. Where a task's objects stand in a row, what
is known of their shape mends what votes gave, and the gaps follow from it (`rows.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.datagen.box_row import BoxRow
from codediffuser.datagen.episode_format import Camera
from codediffuser.datagen.task import Task
from codediffuser.datagen.task_config import ClusterConfig
from codediffuser.labeling.perception.builtin import Perceived
from codediffuser.labeling.perception.cloud import EVEN_POINTS, CloudFuser, WorldCloud
from codediffuser.labeling.perception.clustering import NOISE, cluster_config, cluster_points
from codediffuser.labeling.perception.features import FeatureBackend, sample_map
from codediffuser.labeling.perception.references import ReferenceLibrary, classify
from codediffuser.labeling.perception.rows import RowFinder
from codediffuser.labeling.perception.views import View, stack_views
from codediffuser.labeling.perception.votes import gather_votes
from codediffuser.pointcloud import farthest_point_indices


@runtime_checkable
class VotingBackend(Protocol):
    """A feature backend that also tells where the middle of each pixel's instance lies."""

    def perceive(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None,
        cameras: Sequence[Camera] | None,
    ) -> Perceived:
        """Features and middles; arguments as for `FeatureBackend.maps`."""


@dataclass(frozen=True, slots=True)
class FoundInstance:
    """One thing or place that features show."""

    category: str
    points_world: np.ndarray
    """(N, 3) float32, metres, every reading of it."""
    rgb: np.ndarray
    """(N, 3) uint8, the colours of the points."""
    middle_world: np.ndarray
    """(3,) float64, metres: as voted, or the mean of the points."""
    confidence: float
    """Mean similarity of its points to the references of its category, in [0, 1]."""


def find_instances(
    views: Sequence[View],
    task: Task,
    backend: FeatureBackend,
    library: ReferenceLibrary,
    categories: Sequence[str] | None = None,
) -> tuple[FoundInstance, ...]:
    """Find all instances that the views show in the task's workspace.

    Args:
        views: What the cameras see at one moment.
        task: Gives the workspace and the sizes of its categories.
        backend: Computes features.
        library: What to look for, of the same backend.
        categories: What to look for; None is what the task picks and where it places.

    Returns:
        Instances by category, then in lexicographic order of where they are; none when nothing is
        similar enough.

    Raises:
        ConfigError: The task's YAML does not say how large a category is.
        ShapeError: The views do not fit together.
    """
    box = task.config.workspace
    cloud = CloudFuser(box.low_m, box.high_m).fuse(views, color=True)
    images, depth_m, cameras = stack_views(views)
    middles = None
    if isinstance(backend, VotingBackend):
        perceived = backend.perceive(images, depth_m, cameras)
        maps, middles = perceived.maps, _look_up(perceived.middles_world, cloud, views)
    else:
        maps = backend.maps(images, depth_m, cameras)
    seen = _Seen(cloud, middles, *classify(_features(maps, cloud, views), library), library)
    wanted = tuple(categories or (task.pick_category, task.place_category))
    if task.row is not None and middles is not None:
        found = tuple(_in_row(task, task.row, seen))
        return tuple(f for category in wanted for f in found if f.category == category)
    return tuple(f for category in wanted for f in _of_category(task, category, seen))


@dataclass(frozen=True, slots=True)
class _Seen:
    """All readings of the workspace and what features say of them."""

    cloud: WorldCloud
    middles: np.ndarray | None
    """(N, 3) float32, metres, where the backend votes."""
    number: np.ndarray
    """(N,) index of the category in the library, or negative."""
    similarity: np.ndarray
    """(N,) to the nearest reference."""
    library: ReferenceLibrary

    def of(self, category: str) -> np.ndarray:
        """Indices (n,) of the readings of a category."""
        if category not in self.library.categories:
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero(self.number == self.library.categories.index(category))

    def instance(self, category: str, chosen: np.ndarray) -> FoundInstance:
        """The instance of some readings."""
        points, rgb = self.cloud.points_world[chosen], self.cloud.rgb
        voted = points if self.middles is None else self.middles[chosen]
        return FoundInstance(
            category,
            points,
            np.zeros((len(chosen), 3), np.uint8) if rgb is None else rgb[chosen],
            np.median(voted, axis=0).astype(np.float64),
            float(np.clip(self.similarity[chosen].mean(), 0, 1)),
        )


def _of_category(task: Task, category: str, seen: _Seen) -> Iterator[FoundInstance]:
    """The instances of a category, wherever they are."""
    sizes = cluster_config(task.config.labeling.clusters, category)
    mine = seen.of(category)
    instance = _part(
        seen.cloud.points_world[mine], None if seen.middles is None else seen.middles[mine], sizes
    )
    for row in range(instance.max(initial=NOISE) + 1):
        yield seen.instance(category, mine[instance == row])


def _in_row(task: Task, row: BoxRow, seen: _Seen) -> Iterator[FoundInstance]:
    """Boxes, then gaps, of a row: votes give pieces of boxes, their shape does the rest."""
    assert seen.middles is not None
    labeling = task.config.labeling
    sizes = cluster_config(labeling.clusters, task.pick_category)
    mine = seen.of(task.pick_category)
    points = seen.cloud.points_world[mine]
    pieces = _part(points, seen.middles[mine], sizes.model_copy(update={"min_share": 0.0}))
    finder = RowFinder(row, labeling.row, sizes)
    boxes = finder.boxes(points, pieces)
    found = [seen.instance(task.pick_category, mine[box.shown]) for box in boxes]
    yield from found
    least = cluster_config(labeling.clusters, task.place_category).min_points
    for gap in finder.gaps(seen.cloud.points_world, boxes, least):
        sure = min(found[i].confidence for i in gap.beside)
        yield replace(
            seen.instance(task.place_category, gap.shown),
            middle_world=gap.middle_world,
            confidence=sure,
        )


def _features(maps: np.ndarray, cloud: WorldCloud, views: Sequence[View]) -> np.ndarray:
    """The feature (N, D) at each point's own pixel."""
    features = np.zeros((len(cloud), maps.shape[-1]), dtype=np.float32)
    for number, view in enumerate(views):
        mine = cloud.view == number
        row, column = np.divmod(cloud.pixel[mine], view.camera.width)
        features[mine] = sample_map(
            maps[number], np.column_stack([column, row]), view.rgb.shape[:2]
        )
    return features


def _look_up(middles: np.ndarray, cloud: WorldCloud, views: Sequence[View]) -> np.ndarray:
    """The vote (N, 3) of the cell that each point's pixel lies in; votes are not mixed."""
    h, w = middles.shape[1:3]
    found = np.zeros((len(cloud), 3), dtype=np.float32)
    for number, view in enumerate(views):
        mine = cloud.view == number
        row, column = np.divmod(cloud.pixel[mine], view.camera.width)
        i = (row * h + h // 2) // view.camera.height
        j = (column * w + w // 2) // view.camera.width
        found[mine] = middles[number, np.minimum(i, h - 1), np.minimum(j, w - 1)]
    return found


def _part(points: np.ndarray, middles: np.ndarray | None, sizes: ClusterConfig) -> np.ndarray:
    """Instance (N,) of each point of one category, `NOISE` for none."""
    if middles is not None and sizes.vote_reach_m is not None:
        weighted = middles * np.array(sizes.vote_weights, dtype=np.float32)
        instance, _ = gather_votes(weighted, sizes.vote_reach_m, sizes.min_points, sizes.min_share)
        return instance
    even = farthest_point_indices(points, EVEN_POINTS)
    return _spread(points, even, cluster_points(points[even], sizes), sizes)


def _spread(
    points: np.ndarray, even: np.ndarray, instance: np.ndarray, sizes: ClusterConfig
) -> np.ndarray:
    """Give every point the instance of the nearest of the thinned ones."""
    full = np.full(len(points), NOISE, dtype=np.int64)
    if (instance != NOISE).any():
        known = even[instance != NOISE]
        distance, nearest = cKDTree(points[known]).query(points)
        near = distance <= sizes.eps_m
        full[near] = instance[instance != NOISE][nearest[near]]
    return full
