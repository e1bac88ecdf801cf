"""Visual features: a dense map for each picture, and a feature for each fused point.

A backend turns pictures into maps and knows nothing else; `point_features` looks the maps up at
points of the world, in every camera that sees them. What a feature *means* is decided by reference
features of the same backend (`references.py`).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from codediffuser.datagen.cameras import project
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import ShapeError
from codediffuser.labeling.perception.views import View
from codediffuser.pointcloud import check_points
from codediffuser.registry import Registry

VISIBLE_WITHIN_M = 0.01
"""A camera sees a point when its reading there differs by no more than this."""


class FeatureBackend(Protocol):
    """Computes dense features. One object serves many pictures; it keeps nothing between calls."""

    @property
    def name(self) -> str:
        """What reference features are stored under, with the variant: `dinov2-vits14`."""

    @property
    def dimensions(self) -> int:
        """D, the length of a feature."""

    def maps(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None = None,
        cameras: Sequence[Camera] | None = None,
    ) -> np.ndarray:
        """Compute the feature maps of pictures of one size.

        Args:
            images: (V, H, W, 3) uint8 RGB.
            depth_m: (V, H, W) float32 along the optical axis, metres, 0 or NaN for no reading.
                Backends that see colour alone ignore it.
            cameras: V intrinsics and poses, for backends that use heights or normals.

        Returns:
            maps: (V, h, w, D) float32. The cells cover the picture evenly and without a margin:
            cell (i, j) has its centre at pixel ((j + 0.5) W / w - 0.5, (i + 0.5) H / h - 0.5).

        Raises:
            ShapeError: An input does not have the shape above, or is None and needed.
        """


@dataclass(frozen=True, slots=True)
class FeatureOptions:
    """What a backend may be built from; each takes what concerns it."""

    weights: Path | None = None
    """File of weights; None looks where the backend keeps them."""
    cache: Path | None = None
    """Folder for computed maps; None keeps none."""
    device: str = "cpu"
    """Where torch computes."""
    episode: Episode | None = None
    """Simulated episode whose true shapes `oracle` reads; everything else ignores it."""
    frame: int = 0
    """Frame of that episode."""


FEATURES: Registry[Callable[[FeatureOptions], FeatureBackend]] = Registry("feature backend")

BACKEND_MODULES = ("builtin", "oracle_features", "dinov2")
"""Modules of this folder that fill `FEATURES` when imported; they import torch only when used."""


def get_features(name: str, options: FeatureOptions | None = None) -> FeatureBackend:
    """Build a registered backend.

    Args:
        name: Such as `builtin`, `dinov2`, `oracle`.
        options: Weights, cache, device; None for the defaults.

    Raises:
        NotRegisteredError: No such backend; the message names the closest one.
        SetupError: The backend's weights or packages are missing; the message says where to put
            them.
    """
    check_backend(name)
    return FEATURES.get(name)(options or FeatureOptions())


def check_backend(name: str) -> None:
    """Raise `NotRegisteredError` unless a backend has this name; build nothing."""
    for module in BACKEND_MODULES:
        importlib.import_module(f"codediffuser.labeling.perception.{module}")
    FEATURES.get(name)


def point_features(
    points_world: np.ndarray,
    maps: np.ndarray,
    views: Sequence[View],
    *,
    visible_within_m: float = VISIBLE_WITHIN_M,
) -> tuple[np.ndarray, np.ndarray]:
    """Average each point's feature over the cameras that see it.

    A camera sees a point that falls on its picture and has a reading of the point's own depth
    there; a point that is hidden, or beside the picture, takes nothing from that camera.

    Args:
        points_world: (N, 3) float32, metres; N may be 0.
        maps: (V, h, w, D) float32, one map per view.
        views: V views, as many as maps and in their order.
        visible_within_m: How far a reading may be from the point's depth.

    Returns:
        features: (N, D) float32; zeros where no camera sees the point.
        seen_by: (N,) int64, the number of cameras that see the point.

    Raises:
        ShapeError: The arrays do not fit together.
    """
    check_points(points_world, "points_world")
    if maps.ndim != 4 or len(maps) != len(views):
        raise ShapeError(f"maps: expected shape ({len(views)}, h, w, D), got {maps.shape}")
    total = np.zeros((len(points_world), maps.shape[-1]), dtype=np.float32)
    seen_by = np.zeros(len(points_world), dtype=np.int64)
    for feature_map, view in zip(maps, views, strict=True):
        uv, seen = _visible(points_world, view, visible_within_m)
        total[seen] += sample_map(feature_map, uv[seen], view.depth_m.shape)
        seen_by += seen
    return total / np.maximum(seen_by, 1)[:, None].astype(np.float32), seen_by


def sample_map(feature_map: np.ndarray, uv: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """Look a map up at pixels, bilinearly between the centres of its cells.

    Args:
        feature_map: (h, w, D) float32.
        uv: (N, 2) float, pixels (column, row) of the picture; outside, the nearest cell counts.
        size: (H, W) of the picture.

    Returns:
        features: (N, D) float32. A map as large as the picture is returned exactly at its pixels.
    """
    h, w = feature_map.shape[:2]
    x = np.clip((uv[:, 0] + 0.5) * (w / size[1]) - 0.5, 0, w - 1)
    y = np.clip((uv[:, 1] + 0.5) * (h / size[0]) - 0.5, 0, h - 1)
    x0, y0 = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    x1, y1 = np.minimum(x0 + 1, w - 1), np.minimum(y0 + 1, h - 1)
    fx, fy = (x - x0).astype(np.float32)[:, None], (y - y0).astype(np.float32)[:, None]
    upper = feature_map[y0, x0] * (1 - fx) + feature_map[y0, x1] * fx
    lower = feature_map[y1, x0] * (1 - fx) + feature_map[y1, x1] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, dtype=np.float32)


def _visible(
    points_world: np.ndarray, view: View, within_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) float64 of the points, and which of them (N,) bool the camera sees."""
    camera = view.camera
    uv, z = project(points_world, camera.K, camera.T_world_camera)
    with np.errstate(invalid="ignore"):
        seen = (z > 0) & (uv >= -0.5).all(axis=1)
        seen &= (uv < np.array([camera.width, camera.height]) - 0.5).all(axis=1)
    column, row = np.floor(uv[seen] + 0.5).astype(np.intp).T
    reading = view.depth_m[row, column]
    # A missing reading, 0 or NaN, agrees with no point.
    seen[seen] = np.abs(reading - z[seen]) <= within_m
    return uv, seen
