from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from codediffuser.datagen.episode_format import Camera
from codediffuser.labeling.perception.views import View
from codediffuser.poses import look_rotation, make_transform

BOX_LOW, BOX_HIGH = np.array([-0.05, -0.04, 0.0]), np.array([0.05, 0.04, 0.08])


def ray_cast(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H, W) of the table z = 0 and one box on it, and which pixels show the box."""
    v, u = np.indices((camera.height, camera.width), dtype=np.float64)
    K = camera.K
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
    direction = rays @ camera.T_world_camera[:3, :3].T
    origin = camera.T_world_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        table = np.where(direction[..., 2] < 0, -origin[2] / direction[..., 2], np.inf)
        near, far = ((side - origin) / direction for side in (BOX_LOW, BOX_HIGH))
    enter = np.minimum(near, far).max(axis=-1)
    leave = np.maximum(near, far).min(axis=-1)
    box = np.where((enter < leave) & (enter > 0), enter, np.inf)
    depth = np.minimum(table, box)
    return np.where(np.isfinite(depth), depth, 0).astype(np.float32), box < table


@pytest.fixture(scope="session")
def make_views() -> Callable[..., tuple[View, ...]]:
    """Views of one box on a table by exact ray casting; the box is red, the table green."""

    def make(count: int = 3, width: int = 80, height: int = 60) -> tuple[View, ...]:
        views = []
        focal = height / 2 / np.tan(0.45)
        K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
        for k in range(count):
            turn = 2 * np.pi * k / max(count, 1)
            position = np.array([0.4 * np.cos(turn), 0.4 * np.sin(turn), 0.4])
            right = np.array([-np.sin(turn), np.cos(turn), 0.0])
            T = make_transform(look_rotation(-position, right), position)
            camera = Camera(K, T, width, height)
            depth_m, is_box = ray_cast(camera)
            rgb = np.where(is_box[..., None], [200, 0, 0], [0, 200, 0]).astype(np.uint8)
            views.append(View(f"camera_{k}", rgb, depth_m, camera))
        return tuple(views)

    return make
