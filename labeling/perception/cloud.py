"""One cloud of the world from all cameras: usable readings in the workspace, evenly thinned.

The same points as `pointcloud.fuse_views` and `crop_box`, plus where each came from. It is made
for many frames of the same cameras: the direction in which each pixel looks is computed once, and
what lies outside the workspace is dropped coordinate by coordinate, before points are put together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.episode_format import Camera
from codediffuser.labeling.perception.depth_shape import flying_pixels, normals_camera
from codediffuser.labeling.perception.views import View
from codediffuser.pointcloud import farthest_point_indices

EVEN_POINTS = 8000
"""Points that clustering takes."""


@dataclass(frozen=True, slots=True)
class WorldCloud:
    """Points in the world and the pixels that they were read at."""

    points_world: np.ndarray
    """(N, 3) float32, metres; view by view, row-major within each; N may be 0."""
    view: np.ndarray
    """(N,) int16, index of the view."""
    pixel: np.ndarray
    """(N,) int32, row-major index of the pixel."""
    rgb: np.ndarray | None = None
    """(N, 3) uint8."""
    normals_world: np.ndarray | None = None
    """(N, 3) float32 of length 1, towards the camera; zeros where the surface is not smooth."""

    def __len__(self) -> int:
        return len(self.points_world)

    def take(self, index: np.ndarray) -> WorldCloud:
        """The points of an index or a mask, in its order."""
        return WorldCloud(
            self.points_world[index],
            self.view[index],
            self.pixel[index],
            None if self.rgb is None else self.rgb[index],
            None if self.normals_world is None else self.normals_world[index],
        )


class CloudFuser:
    """Fuses depth of any frames of some cameras into clouds of one workspace.

    Args:
        low_m: (3,) lower corner of the workspace, world, metres.
        high_m: (3,) upper corner.
        min_depth_m: Nearer readings are left out.
        max_depth_m: Farther readings are left out.
        drop_flying: Whether to leave out pixels that hang between two surfaces.
    """

    def __init__(
        self,
        low_m: Sequence[float],
        high_m: Sequence[float],
        *,
        min_depth_m: float = 0.05,
        max_depth_m: float = 2.0,
        drop_flying: bool = True,
    ) -> None:
        self.low_m = np.asarray(low_m, dtype=np.float32)
        self.high_m = np.asarray(high_m, dtype=np.float32)
        self.min_depth_m = np.float32(min_depth_m)
        self.max_depth_m = np.float32(max_depth_m)
        self.drop_flying = drop_flying
        self._rays: dict[bytes, np.ndarray] = {}

    def fuse(
        self, views: Sequence[View], *, color: bool = False, normals: bool = False
    ) -> WorldCloud:
        """Join what the views read inside the workspace.

        Args:
            views: Any number; none gives an empty cloud.
            color: Whether to look up colours.
            normals: Whether to compute normals.
        """
        parts = [self._lift(view) for view in views]
        pixels = [pixel for _, pixel in parts]
        points = np.concatenate([np.zeros((0, 3), np.float32), *(p for p, _ in parts)])
        number = np.repeat(np.arange(len(views), dtype=np.int16), [len(p) for p in pixels])
        pixel = np.concatenate([np.zeros(0, np.int32), *pixels])
        return WorldCloud(
            points,
            number,
            pixel,
            _joined([v.rgb.reshape(-1, 3) for v in views], pixels, np.uint8) if color else None,
            _joined([_normals_world(v) for v in views], pixels, np.float32) if normals else None,
        )

    def even(self, cloud: WorldCloud, count: int = EVEN_POINTS) -> WorldCloud:
        """Thin a cloud to `count` points of even density by farthest point sampling."""
        return cloud.take(farthest_point_indices(cloud.points_world, count))

    def _lift(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Points (M, 3) float32 of the world inside the workspace, and their pixels (M,) int32."""
        z = view.depth_m.reshape(-1)
        usable = (z >= self.min_depth_m) & (z <= self.max_depth_m)  # False for NaN
        if self.drop_flying:
            usable &= ~flying_pixels(view.depth_m, view.camera.K).reshape(-1)
        pixel: np.ndarray = np.flatnonzero(usable).astype(np.int32)
        rays, origin = self._world_rays(view.camera), view.camera.T_world_camera[:3, 3]
        z = z[pixel]
        columns: list[np.ndarray] = []
        # Height first: most of what lies outside is table, floor and robot.
        for axis in (2, 0, 1):
            column = rays[axis, pixel] * z + np.float32(origin[axis])
            inside = (column >= self.low_m[axis]) & (column <= self.high_m[axis])
            pixel, z = pixel[inside], z[inside]
            columns = [c[inside] for c in (*columns, column)]
        height, x, y = columns
        return np.stack([x, y, height], axis=-1), pixel

    def _world_rays(self, camera: Camera) -> np.ndarray:
        """What each pixel sees at depth 1, from the camera: (3, H * W) float32, world axes."""
        size = np.array([camera.height, camera.width])
        key = camera.K.tobytes() + camera.T_world_camera.tobytes() + size.tobytes()
        if key not in self._rays:
            v, u = np.indices((camera.height, camera.width), dtype=np.float64).reshape(2, -1)
            x = (u - camera.K[0, 2]) / camera.K[0, 0]
            y = (v - camera.K[1, 2]) / camera.K[1, 1]
            in_camera = np.stack([x, y, np.ones_like(x)])
            self._rays[key] = (camera.T_world_camera[:3, :3] @ in_camera).astype(np.float32)
        return self._rays[key]


def _joined(
    per_view: Sequence[np.ndarray], pixels: Sequence[np.ndarray], dtype: type[np.generic]
) -> np.ndarray:
    chosen = [values[pixel] for values, pixel in zip(per_view, pixels, strict=True)]
    return np.concatenate([np.zeros((0, 3), dtype), *chosen])


def _normals_world(view: View) -> np.ndarray:
    """Normals of all pixels, (H * W, 3) float32."""
    R = view.camera.T_world_camera[:3, :3].astype(np.float32)
    return np.asarray(normals_camera(view.depth_m, view.camera.K).reshape(-1, 3) @ R.T)
