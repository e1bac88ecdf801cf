"""What an episode's log holds of one control step: joints, hand, pictures, and the command."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import EpisodeError


@dataclass(frozen=True, slots=True)
class StoredPicture:
    """A colour picture that is compressed already, and is kept byte for byte."""

    data: bytes
    """A JPEG or PNG file."""
    format: Literal["jpeg", "png"]
    height: int
    width: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """(H, W, 3), as of the picture in it."""
        return self.height, self.width, 3


@dataclass(frozen=True, slots=True)
class Pictures:
    """What the cameras saw at one moment, by camera name."""

    rgb: Mapping[str, np.ndarray | StoredPicture]
    """(H, W, 3) uint8, or as it was recorded."""
    depth_mm: Mapping[str, np.ndarray]
    """(H, W) uint16, 0 for no reading."""


@dataclass(frozen=True, slots=True)
class LogStep:
    """One control step: what was sensed, then what was commanded."""

    qpos: np.ndarray
    """(n,) float64, rad or m."""
    qvel: np.ndarray
    """(n,) float64, rad/s or m/s."""
    T_world_hand: np.ndarray | None
    """(4, 4) float64; None when the episode's motion is of kind `joints`."""
    action: np.ndarray
    """(10,) float32, see `trajectory.ACTION_NAMES`; for joints (m,), as the motion names them."""
    pictures: Pictures
    T_world_camera: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(4, 4) float64 of every moving camera."""


def trajectory_steps(trajectory: Trajectory, pictures: Iterable[Pictures]) -> Iterator[LogStep]:
    """Join a trajectory of T actions with T sets of pictures, one for each moment but the last.

    Raises:
        EpisodeError: There are fewer or more sets of pictures than actions.
    """
    given = iter(pictures)
    for k in range(trajectory.num_steps):
        seen = next(given, None)
        if seen is None:
            raise EpisodeError(f"expected {trajectory.num_steps} sets of pictures, got {k}")
        yield LogStep(
            qpos=trajectory.qpos[k],
            qvel=trajectory.qvel[k],
            T_world_hand=trajectory.T_world_hand(k),
            action=trajectory.actions[k],
            pictures=seen,
        )
    if next(given, None) is not None:
        raise EpisodeError(f"expected {trajectory.num_steps} sets of pictures, got more")
