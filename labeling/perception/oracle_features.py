"""The `oracle` backend: which category a pixel truly shows, one number per category.

It knows the simulator's shapes and poses, so it is for tests and for ground truth alone: with it,
whatever goes wrong after the features is the fault of what comes after them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from codediffuser.datagen.episode_format import Camera
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import Task, get_task
from codediffuser.errors import EpisodeError, ShapeError
from codediffuser.labeling.ground_truth import GroundTruthConfig, object_members, place_members
from codediffuser.labeling.perception.features import FEATURES, FeatureOptions
from codediffuser.pointcloud import backproject_depth

BACKGROUND = "background"


class OracleFeatures:
    """One-hot features: background first, then the categories of the scene, sorted.

    Args:
        task: Gives the shapes of the scene's objects.
        scene: What stands where.
        T_world_now: Poses (4, 4) of the movable objects at the moment of the pictures; an object
            without one is where the scene puts it.
    """

    name = "oracle"

    def __init__(self, task: Task, scene: SceneSpec, T_world_now: Mapping[str, np.ndarray]) -> None:
        self.task = task
        self.scene = scene
        self.T_world_now = T_world_now
        found = {o.category for o in scene.objects} | {p.category for p in scene.places}
        self.categories = (BACKGROUND, *sorted(found))
        """What each dimension stands for."""

    @property
    def dimensions(self) -> int:
        """One per category, and one for the background."""
        return len(self.categories)

    def maps(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None = None,
        cameras: Sequence[Camera] | None = None,
    ) -> np.ndarray:
        """Maps (V, H, W, D) as large as the pictures; see `FeatureBackend.maps`.

        Raises:
            ShapeError: Depth or cameras are missing: shapes are looked up in the world.
        """
        names = np.array([BACKGROUND, *self.ids()])
        category_of = {o.id: o.category for o in self.scene.objects}
        category_of |= {p.id: p.category for p in self.scene.places}
        column = [self.categories.index(category_of.get(n, BACKGROUND)) for n in names]
        one_hot = np.eye(self.dimensions, dtype=np.float32)[column]
        return np.asarray(one_hot[self.id_maps(images, depth_m, cameras)])

    def ids(self) -> tuple[str, ...]:
        """Ids of objects and places in the order in which `id_maps` numbers them, from 1."""
        return (*(o.id for o in self.scene.objects), *(p.id for p in self.scene.places))

    def id_maps(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None,
        cameras: Sequence[Camera] | None,
    ) -> np.ndarray:
        """What each pixel shows: (V, H, W) int64, 0 for the background, else 1 + index of `ids`.

        A place wins over the fixed body that it is a part of.
        """
        if depth_m is None or cameras is None:
            raise ShapeError("the oracle backend needs depth_m and cameras, got None")
        if len(depth_m) != len(cameras) or len(images) != len(depth_m):
            raise ShapeError(
                f"expected as many pictures, depths and cameras, got {len(images)}, "
                f"{len(depth_m)} and {len(cameras)}"
            )
        ids = np.zeros(depth_m.shape, dtype=np.int64)
        for depth, camera, flat in zip(depth_m, cameras, ids.reshape(len(ids), -1), strict=True):
            points, pixel = backproject_depth(depth, camera.K, camera.T_world_camera)
            flat[pixel] = self._point_ids(points)
        return ids

    def _point_ids(self, points_world: np.ndarray) -> np.ndarray:
        margin_m = GroundTruthConfig().margin_m
        ids = np.zeros(len(points_world), dtype=np.int64)
        for number, obj in enumerate(self.scene.objects, start=1):
            found = object_members(
                self.task, self.scene, obj, self.T_world_now, points_world, margin_m
            )
            ids[found] = number
        for number, place in enumerate(self.scene.places, start=1 + len(self.scene.objects)):
            found = place_members(
                self.task, self.scene, place, self.T_world_now, points_world, margin_m
            )
            ids[found] = number
        return ids


@FEATURES.add("oracle")
def _from_options(options: FeatureOptions) -> OracleFeatures:
    episode = options.episode
    if episode is None:
        raise EpisodeError(
            "the oracle backend reads a simulated episode; pass FeatureOptions(episode=...)"
        )
    trajectory = episode.trajectory
    T_now = {n: trajectory.T_world_object(n, options.frame) for n in trajectory.object_ids}
    return OracleFeatures(get_task(episode.scene.task), episode.scene, T_now)
