"""What the simulator knew at every control step: enough to draw an episode again."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from codediffuser.errors import EpisodeError
from codediffuser.files import atomic_path
from codediffuser.poses import pose_to_transform

CONTROL_HZ = 25
ACTION_NAMES = (
    "x", "y", "z", "r00", "r10", "r20", "r01", "r11", "r21", "gripper",
)  # fmt: skip
"""Absolute hand pose in the world: metres, rotation-6D (first two columns), finger opening in m."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """States at T + 1 moments and the T actions between them; moment 0 is the reset.

    `hand` is the link `panda_hand`. Object arrays follow the order of `object_ids`.
    """

    object_ids: tuple[str, ...]
    """Ids of all bodies that can move."""
    object_position_m: np.ndarray
    """(T + 1, n_objects, 3) float64, world."""
    object_quat_wxyz: np.ndarray
    """(T + 1, n_objects, 4) float64."""
    object_velocity: np.ndarray
    """(T + 1, n_objects, 6) float64: linear m/s, then angular rad/s, world."""
    qpos: np.ndarray
    """(T + 1, 9) float64: seven arm joints in rad, two fingers in m."""
    qvel: np.ndarray
    """(T + 1, 9) float64."""
    hand_position_m: np.ndarray
    """(T + 1, 3) float64, world."""
    hand_quat_wxyz: np.ndarray
    """(T + 1, 4) float64."""
    actions: np.ndarray
    """(T, 10) float32, see `ACTION_NAMES`."""

    @property
    def num_steps(self) -> int:
        """T, the number of actions."""
        return len(self.actions)

    def T_world_object(self, object_id: str, moment: int) -> np.ndarray:
        """Pose (4, 4) float64 of one object at one moment (negative counts from the end)."""
        i = self.object_ids.index(object_id)
        return pose_to_transform(
            self.object_position_m[moment, i], self.object_quat_wxyz[moment, i]
        )

    def T_world_hand(self, moment: int) -> np.ndarray:
        """Pose (4, 4) float64 of the hand at one moment."""
        return pose_to_transform(self.hand_position_m[moment], self.hand_quat_wxyz[moment])

    def save(self, path: Path) -> None:
        """Write one `.npz`, the same bytes for the same numbers."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        with atomic_path(path) as partial, partial.open("wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: Path) -> Trajectory:
        """Read what `save` wrote.

        Raises:
            EpisodeError: The file is missing, damaged, or lacks an array.
        """
        try:
            with np.load(path, allow_pickle=False) as raw:
                arrays = {f.name: raw[f.name] for f in fields(cls)}
        except FileNotFoundError:
            raise EpisodeError(f"{path}: no such state file") from None
        except (KeyError, ValueError, OSError, zipfile.BadZipFile) as error:
            raise EpisodeError(f"{path}: damaged state file: {error}") from None
        arrays["object_ids"] = tuple(str(name) for name in arrays["object_ids"])
        return cls(**arrays)
