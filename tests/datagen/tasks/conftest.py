"""Made-up states of a scene, for checks and scripts without a simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from codediffuser.datagen.scene import SceneSpec


@dataclass
class MadeUpView:
    """A `SceneView` whose every part a test may set."""

    scene: SceneSpec
    poses: dict[str, np.ndarray]
    """Objects that are not named here stand as in the scene."""
    hand: np.ndarray
    opening_m: float
    speed: tuple[float, float]
    """Of every object, m/s and rad/s."""

    def T_world_object(self, object_id: str) -> np.ndarray:
        return self.poses.get(object_id, self.scene.object(object_id).T_world_object)

    def object_speed(self, object_id: str) -> tuple[float, float]:
        return self.speed

    def T_world_hand(self) -> np.ndarray:
        return self.hand

    def gripper_opening_m(self) -> float:
        return self.opening_m


@pytest.fixture
def make_view(hand_away: np.ndarray) -> Callable[..., MadeUpView]:
    """State of a scene at rest, the open hand at the module's `hand_away`; arguments change that.

    The function takes the scene, poses by object id, `hand`, `opening_m` and `speed`.
    """

    def make(
        scene: SceneSpec,
        poses: dict[str, np.ndarray] | None = None,
        *,
        hand: np.ndarray = hand_away,
        opening_m: float = 0.04,
        speed: tuple[float, float] = (0.0, 0.0),
    ) -> MadeUpView:
        return MadeUpView(scene, dict(poses or {}), hand, opening_m, speed)

    return make
