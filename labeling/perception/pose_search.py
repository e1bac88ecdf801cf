"""How well pictures explain an object at a pose, and the pose nearby that they explain best.

`fitting.evidence` counts points that agree within half a centimetre; here each point counts the
more the nearer its reading is and the more alike its colour, so that a pose can be improved step by
step, and things of one shape side by side are told apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from codediffuser.datagen.cameras import project
from codediffuser.labeling.perception.fitting import AGREES_M
from codediffuser.labeling.perception.views import View
from codediffuser.poses import apply_transform, make_transform

SPREAD_M = 0.003
"""A reading this far from a point's depth shows it by exp(-1)."""
ALIKE, UNLIKE = 0.3, 0.6
"""Largest difference of a colour channel, of 1: up to the first colours are the same, from the
second on they are not. Between lies what light and shadow do."""
OTHER_COLOR = 0.3
"""How much a reading of another colour counts."""
STEP_M, STEP_RAD = 0.008, 0.06
"""First steps of a search."""
LEAST_M = 0.0008
"""A search ends when its steps are smaller."""
MAX_STEPS = 40
COST_PER_M = 2.0
"""A pose 5 mm away from where a search began must explain 1 % of the points more."""


@dataclass(frozen=True, slots=True)
class Model:
    """What an object looks like."""

    points: np.ndarray
    """(N, 3) float64, metres, N >= 1."""
    rgb: np.ndarray
    """(N, 3) float32 in [0, 1]; NaN where no picture shows the point."""


def model_of(points_world: np.ndarray, views: Sequence[View]) -> Model:
    """Take the colours of points (N, 3) from the picture whose reading is nearest to each."""
    rgb = np.full((len(points_world), 3), np.nan, dtype=np.float32)
    nearest = np.full(len(points_world), AGREES_M)
    for view in views:
        index, pixel, beyond = _readings(points_world, view)
        better = np.abs(beyond) < nearest[index]
        index, pixel = index[better], pixel[better]
        nearest[index] = np.abs(beyond[better])
        rgb[index] = view.rgb.reshape(-1, 3)[pixel] / np.float32(255)
    return Model(np.asarray(points_world, dtype=np.float64), rgb)


def explained(model: Model, poses: np.ndarray, views: Sequence[View]) -> np.ndarray:
    """Tell how well views explain the object at each of some poses.

    Args:
        model: Its points.
        poses: (C, 4, 4) what moves the points to where they may be, C >= 1.
        views: All cameras at one moment.

    Returns:
        (C,) float64, at most 1: mean over the points of how surely some view shows the point, less
        1 for each that no view shows and one looks through. What is hidden counts 0.
    """
    count = len(model.points)
    points = np.concatenate([apply_transform(T, model.points) for T in poses])
    color = np.tile(model.rgb, (len(poses), 1))
    shown = np.zeros(len(points))
    through = np.zeros(len(points), dtype=bool)
    for view in views:
        index, pixel, beyond = _readings(points, view)
        sure = np.exp(-((beyond / SPREAD_M) ** 2))
        near = np.flatnonzero(sure > 0.01)
        off = np.abs(view.rgb.reshape(-1, 3)[pixel[near]] / np.float32(255) - color[index[near]])
        unlike = np.clip((off.max(axis=1) - ALIKE) / (UNLIKE - ALIKE), 0.0, 1.0)
        sure[near] *= 1.0 - (1.0 - OTHER_COLOR) * np.nan_to_num(unlike)
        shown[index] = np.maximum(shown[index], sure)
        through[index[beyond > AGREES_M]] = True
    value = shown - through * (1.0 - shown)
    return np.asarray(value.reshape(-1, count).mean(axis=1))


def best_nearby(model: Model, T: np.ndarray, views: Sequence[View]) -> tuple[np.ndarray, float]:
    """Improve a pose (4, 4) step by step; returns it and how well it is explained.

    Steps go along and about the axes of the world through the middle of the object, and are halved
    when none of them helps. What moves far must explain more: a round thing would else turn on its
    axis for nothing.

    Source: Hooke and Jeeves, Direct Search Solution of Numerical and Statistical Problems, 1961.
    """
    begin = apply_transform(T, model.points)
    best, scale = float(explained(model, T[None], views)[0]), 1.0
    for _ in range(MAX_STEPS):
        candidates = _moved(T, apply_transform(T, model.points).mean(axis=0), scale)
        moved_m = [
            np.linalg.norm(apply_transform(C, model.points) - begin, axis=1).mean()
            for C in candidates
        ]
        values = explained(model, candidates, views) - COST_PER_M * np.array(moved_m)
        row = int(values.argmax())
        if values[row] > best + 1e-4:
            T, best = candidates[row], float(values[row])
        elif STEP_M * (scale := scale / 2) < LEAST_M:
            break
    return T, float(explained(model, T[None], views)[0])


def tilted(T: np.ndarray, middle_world: np.ndarray, angle_rad: float) -> list[np.ndarray]:
    """A pose (4, 4) tilted to eight sides about a middle (3,)."""
    poses = []
    for turn in np.arange(8) * np.pi / 4:
        axis = np.array([np.cos(turn), np.sin(turn), 0.0])
        R = Rotation.from_rotvec(angle_rad * axis).as_matrix()
        poses.append(make_transform(R, middle_world - R @ middle_world) @ T)
    return poses


def _moved(T: np.ndarray, middle: np.ndarray, scale: float) -> np.ndarray:
    """A pose moved both ways along and about each axis: (12, 4, 4)."""
    moves = []
    for sign in (-scale, scale):
        for axis in np.eye(3):
            moves.append(make_transform(np.eye(3), sign * STEP_M * axis))
            R = Rotation.from_rotvec(sign * STEP_RAD * axis).as_matrix()
            moves.append(make_transform(R, middle - R @ middle))
    return np.stack(moves) @ T


def _readings(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that fall on a reading: their index, its pixel, how far beyond the point it lies."""
    camera = view.camera
    uv, z = project(points, camera.K, camera.T_world_camera)
    size = np.array([camera.width, camera.height])
    with np.errstate(invalid="ignore"):
        inside = (z > 0) & (uv >= -0.5).all(axis=1) & (uv < size - 0.5).all(axis=1)
    index = np.flatnonzero(inside)
    column, row = np.floor(uv[index] + 0.5).astype(np.intp).T
    pixel = row * camera.width + column
    reading = view.depth_m.reshape(-1)[pixel]
    read = reading > 0  # False for NaN
    return index[read], pixel[read], reading[read] - z[index[read]]
