"""An episode as the viewers show it: a cloud in attention colours, pictures, numbers over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from codediffuser.datagen.episode_format import Camera
from codediffuser.labeling.gui.pictures import ROLE_RGB
from codediffuser.pointcloud import backproject_depth

MAX_POINTS = 20_000
"""Clouds are thinned to that many points."""


@dataclass(frozen=True, slots=True)
class Shot:
    """One moment."""

    points_world: np.ndarray
    """(N, 3) float32, metres; N may be 0."""
    rgb: np.ndarray
    """(N, 3) uint8, attended points in the colours of their role."""
    pictures: Mapping[str, np.ndarray]
    """(H, W, 3) uint8 by camera."""


class EpisodeView(Protocol):
    """One episode of a run or of a dataset."""

    @property
    def id(self) -> str:
        """Its id."""

    @property
    def title(self) -> str:
        """Sentence and outcome."""

    @property
    def hz(self) -> float:
        """Frames per second."""

    @property
    def state(self) -> np.ndarray:
        """(T, n) float32."""

    @property
    def action(self) -> np.ndarray:
        """(T, m) float32."""

    @property
    def names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """What the columns of state and of action are called."""

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """Calibrated cameras, where they stand at first."""

    def shot(self, k: int) -> Shot:
        """What there was at frame k."""


@dataclass(frozen=True, slots=True)
class Shelf:
    """The episodes of a run or a dataset, opened one at a time."""

    ids: tuple[str, ...]
    open: Callable[[str], EpisodeView]


def hand_path(view: EpisodeView) -> np.ndarray:
    """Way of the hand (T, 3) in the world, metres; (0, 3) when the state has no x, y, z."""
    names = view.names[0]
    if not {"x", "y", "z"} <= set(names):
        return np.zeros((0, 3), dtype=np.float32)
    return np.asarray(view.state[:, [names.index(n) for n in "xyz"]])


def colored_points(
    depth_m: np.ndarray, rgb: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) of one picture, their colours (N, 3), and the pixel of each (N,)."""
    points, pixel = backproject_depth(depth_m, camera.K, camera.T_world_camera)
    return points, rgb.reshape(-1, 3)[pixel], pixel


def paint(rgb: np.ndarray, attention: np.ndarray) -> np.ndarray:
    """Colours (N, 3) uint8 with attended points in those of their role; attention is (N, R)."""
    painted = rgb.copy()
    for channel, color in enumerate(ROLE_RGB):
        painted[attention[:, channel] > 0] = color
    return painted


def joined(clouds: Sequence[np.ndarray], columns: int, dtype: type) -> np.ndarray:
    """Clouds one after another; (0, columns) for none."""
    return np.concatenate([np.zeros((0, columns), dtype), *clouds])
