"""The two planes that targets are chosen in, and where the browser's camera stands to show one.

A plane takes its own coordinates (metres on the table, or pixels) to the world and rays back to
its coordinates. Rays come from the browser, so panning and zooming change nothing here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from codediffuser.datagen.episode_format import Camera
from codediffuser.labeling.instances import SelectableInstance
from codediffuser.poses import apply_transform, invert_transform

TOP_FOV_RAD = np.deg2rad(2.5)
"""So narrow that what stands 6 cm high is shifted by less than 1 mm at the edge of a crate."""

TOP_MARGIN = 1.12
"""Height and width shown, as a multiple of what the instances cover."""

PICTURE_DEPTH_M = 0.5
"""How far before the camera its picture hangs."""


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Where the browser's camera stands, as viser takes it."""

    position: np.ndarray
    """(3,) world, metres."""
    look_at: np.ndarray
    up: np.ndarray
    fov_y_rad: float


class Plane(Protocol):
    """What both planes can do."""

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 2) of the plane as (N, 3) float64 world, metres."""

    def from_ray(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Where a ray of the world meets the plane, (2,)."""

    def viewpoint(self, aspect: float) -> Viewpoint:
        """From where all of it is seen in a window of width / height `aspect`."""


@dataclass(frozen=True, slots=True)
class TopPlane:
    """The table seen from straight above: world x to the right, y up."""

    low: np.ndarray
    """(2,) corner of what is shown, metres."""
    high: np.ndarray
    z_m: float
    """Height that clicks are meant at: half way up the instances."""

    @classmethod
    def around(cls, instances: Sequence[SelectableInstance], low: np.ndarray, high: np.ndarray,
               ) -> TopPlane:  # fmt: skip
        """Show all instances; the workspace low..high (3,) when there are none."""
        if not instances:
            return cls(np.asarray(low[:2]), np.asarray(high[:2]), 0.0)
        points = np.concatenate([i.points_world for i in instances])
        bottom, top = points.min(axis=0), points.max(axis=0)
        return cls(bottom[:2], top[:2], float((bottom[2] + top[2]) / 2))

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 2) at the height of the plane."""
        return self.at(points, self.z_m)

    def at(self, points: np.ndarray, z_m: float) -> np.ndarray:
        """Points (N, 2) at another height."""
        return np.column_stack([points, np.full(len(points), z_m)])

    def from_ray(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """World x and y where a ray comes to the height of the plane."""
        return np.asarray((origin + direction * (self.z_m - origin[2]) / direction[2])[:2])

    def viewpoint(self, aspect: float) -> Viewpoint:
        """High above the middle."""
        width, height = (self.high - self.low) * TOP_MARGIN
        shown = max(float(height), float(width) / aspect)
        distance = shown / 2 / np.tan(TOP_FOV_RAD / 2)
        middle = np.append((self.low + self.high) / 2, self.z_m)
        eye = middle + np.array([0.0, 0.0, distance])
        return Viewpoint(eye, middle, np.array([0.0, 1.0, 0.0]), float(TOP_FOV_RAD))


@dataclass(frozen=True, slots=True)
class PicturePlane:
    """One camera's picture, hung before the camera that took it; coordinates are its pixels."""

    camera: Camera

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the hung picture."""
        K = self.camera.K
        scale = PICTURE_DEPTH_M
        return self.camera.width / K[0, 0] * scale, self.camera.height / K[1, 1] * scale

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Where pixels (N, 2) of the hung picture are."""
        return self._lift(points, PICTURE_DEPTH_M)

    def before(self, points: np.ndarray, share: float = 0.995) -> np.ndarray:
        """The same a little before the picture, at a share of its depth, to draw on it."""
        return self._lift(points, share * PICTURE_DEPTH_M)

    def from_ray(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Pixel (column, row) where a ray meets the picture."""
        T = invert_transform(self.camera.T_world_camera)
        start, along = T[:3, :3] @ origin + T[:3, 3], T[:3, :3] @ direction
        x, y, _ = start + along * (PICTURE_DEPTH_M - start[2]) / along[2]
        K = self.camera.K
        return np.array([K[0, 0] * x, K[1, 1] * y]) / PICTURE_DEPTH_M + [K[0, 2], K[1, 2]]

    def viewpoint(self, aspect: float) -> Viewpoint:
        """From the camera itself, wide enough for the whole picture."""
        K, width, height = self.camera.K, self.camera.width, self.camera.height
        tall = max(K[1, 2] + 0.5, height - 0.5 - K[1, 2]) / K[1, 1]
        wide = max(K[0, 2] + 0.5, width - 0.5 - K[0, 2]) / K[0, 0]
        T = self.camera.T_world_camera
        return Viewpoint(
            T[:3, 3], T[:3, 3] + PICTURE_DEPTH_M * T[:3, 2], -T[:3, 1],
            float(2 * np.arctan(1.02 * max(tall, wide / aspect))),
        )  # fmt: skip

    def _lift(self, points: np.ndarray, depth_m: float) -> np.ndarray:
        K = self.camera.K
        x = (points[:, 0] - K[0, 2]) / K[0, 0] * depth_m
        y = (points[:, 1] - K[1, 2]) / K[1, 1] * depth_m
        lifted = np.column_stack([x, y, np.full(len(points), depth_m)])
        return apply_transform(self.camera.T_world_camera, lifted)


def screen_ray(
    screen: np.ndarray, R_world_view: np.ndarray, fov_y_rad: float, aspect: float
) -> np.ndarray:
    """Direction (3,) of the ray through a place of the window.

    Args:
        screen: (2,) from 0 to 1, origin at the top left.
        R_world_view: (3, 3) orientation of the browser's camera, OpenCV axes.
        fov_y_rad: Its vertical field of view.
        aspect: Width / height of the window.
    """
    tall = np.tan(fov_y_rad / 2)
    along = np.array([(2 * screen[0] - 1) * tall * aspect, (2 * screen[1] - 1) * tall, 1.0])
    return np.asarray(R_world_view @ along)


def project_to_screen(
    point_world: np.ndarray, viewpoint: Viewpoint, aspect: float
) -> tuple[float, float]:
    """Where a point of the world is in the window, 0 to 1 from the top left; for scripts."""
    forward = viewpoint.look_at - viewpoint.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, viewpoint.up)
    right = right / np.linalg.norm(right)
    offset = point_world - viewpoint.position
    depth = offset @ forward
    tall = np.tan(viewpoint.fov_y_rad / 2)
    x = offset @ right / depth / tall / aspect
    y = offset @ np.cross(forward, right) / depth / tall
    return float((x + 1) / 2), float((y + 1) / 2)
