"""What perception looks at: the pictures, depths and poses of all cameras at one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import EpisodeError, ShapeError


@dataclass(frozen=True, slots=True)
class View:
    """One camera at one moment."""

    name: str
    rgb: np.ndarray
    """(H, W, 3) uint8."""
    depth_m: np.ndarray
    """(H, W) float32 along the optical axis, metres; 0 or NaN where there is no reading."""
    camera: Camera

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        if self.rgb.shape != (*shape, 3) or self.rgb.dtype != np.uint8:
            raise ShapeError(
                f"camera '{self.name}': expected a picture {(*shape, 3)} uint8 as its intrinsics "
                f"say, got {self.rgb.shape} {self.rgb.dtype}"
            )
        if self.depth_m.shape != shape:
            raise ShapeError(
                f"camera '{self.name}': expected depth {shape} as its intrinsics say, "
                f"got {self.depth_m.shape}"
            )


def views_at(episode: Episode, frame: int = 0) -> tuple[View, ...]:
    """Read what the calibrated cameras with depth see at one frame, in the episode's order.

    Raises:
        EpisodeError: There is no such frame, or the log is damaged.
    """
    cameras = episode.depth_cameras
    read = episode.frame(frame, list(cameras))
    return tuple(View(n, read.rgb[n], read.depth_m[n], c) for n, c in cameras.items())


def stack_views(views: Sequence[View]) -> tuple[np.ndarray, np.ndarray, tuple[Camera, ...]]:
    """Stack views of one size for a feature backend.

    Returns:
        images: (V, H, W, 3) uint8 RGB.
        depth_m: (V, H, W) float32, metres.
        cameras: V intrinsics and poses.

    Raises:
        EpisodeError: There is no view.
        ShapeError: The views differ in size.
    """
    if not views:
        raise EpisodeError("no camera gives calibrated depth, so there is nothing to perceive")
    if len({v.depth_m.shape for v in views}) > 1:
        sizes = ", ".join(f"{v.name} {v.depth_m.shape}" for v in views)
        raise ShapeError(f"expected cameras of one picture size (H, W), got {sizes}")
    return (
        np.stack([v.rgb for v in views]),
        np.stack([v.depth_m for v in views]).astype(np.float32),
        tuple(v.camera for v in views),
    )
