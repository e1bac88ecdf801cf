"""The scripted expert of pack_battery: thirteen moves of the hand."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from codediffuser.datagen.scene import Vector3
from codediffuser.datagen.task import Move, SceneView
from codediffuser.poses import make_transform, rotation_z
from codediffuser.schema import Strict

R_WORLD_HAND_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""The hand points down and its fingers open along world x."""


class ScriptConfig(Strict):
    """Heights of the hand above the table, and how much each demonstration varies."""

    travel_z_m: float
    pregrasp_z_m: float
    grasp_z_m: float
    prerelease_z_m: float
    release_z_m: float
    home_m: Vector3
    open_m: float
    noise_xy_m: float
    noise_yaw_rad: float


def packing_moves(
    config: ScriptConfig, view: SceneView, rng: np.random.Generator
) -> Iterator[Move]:
    """The thirteen phases of the reference, 185 control steps, from the state as it is seen."""
    s, scene = config, view.scene
    travel, low, closed = s.travel_z_m, s.pregrasp_z_m, 0.0

    def noise(scale: float) -> np.ndarray:
        xy = rng.uniform(-1, 1, size=2) * s.noise_xy_m * scale
        return np.array([xy[0], xy[1], rng.uniform(-1, 1) * s.noise_yaw_rad])

    def hand(xy: np.ndarray, z: float, offset: np.ndarray | None = None) -> np.ndarray:
        dx, dy, yaw = offset if offset is not None else (0.0, 0.0, 0.0)
        R = rotation_z(yaw) @ R_WORLD_HAND_DOWN
        return make_transform(R, np.array([xy[0] + dx, xy[1] + dy, z]))

    battery = view.T_world_object(scene.target.pick)[:2, 3]
    slot = np.array(scene.place(scene.target.place).position_m[:2])
    home = make_transform(R_WORLD_HAND_DOWN, np.array(s.home_m))

    yield Move("approach", hand(battery, travel, noise(3)), 15, s.open_m)
    yield Move("approach", hand(battery, low), 10, s.open_m)
    yield Move("descend", hand(battery, s.grasp_z_m), 15, s.open_m)
    yield Move("grasp", hand(battery, s.grasp_z_m), 10, closed)
    yield Move("grasp", hand(battery, s.grasp_z_m), 5, closed)
    yield Move("lift", hand(battery, travel, noise(1)), 15, closed)
    yield Move("transport", hand(slot, travel, noise(2)), 30, closed)
    yield Move("lower", hand(slot, s.prerelease_z_m), 15, closed)
    yield Move("lower", hand(slot, s.release_z_m), 15, closed)
    yield Move("release", hand(slot, s.release_z_m), 10, s.open_m)
    yield Move("retreat", hand(slot, travel, noise(1)), 15, s.open_m)
    yield Move("home", home, 15, s.open_m)
    yield Move("home", home, 15, s.open_m)
