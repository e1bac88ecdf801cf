"""Whether points explain what cameras see, and the rigid motion that makes them do so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.datagen.cameras import project
from codediffuser.labeling.perception.views import View
from codediffuser.poses import apply_transform, make_transform

AGREES_M = 0.005
"""A reading this near to a point's depth shows the point."""
MIN_SHOWN = 0.25
"""Share of the points that must be shown to be sure of a pose."""
ROUNDS = 60
STILL = 1e-5
"""A round that changes no entry of the pose by more ends the fit."""
KEPT = 0.7
"""Share of the nearest pairs that a fit is made of; the rest are sides that are hidden now."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What cameras say of points at a supposed pose, as shares of the points.

    What every camera sees hidden behind something counts neither way.
    """

    shown: float
    """Some camera reads the point's own depth."""
    missing: float
    """No camera shows it, and one looks through it."""

    @property
    def balance(self) -> float:
        """What speaks for the pose less what speaks against it, -1 to 1."""
        return self.shown - self.missing

    @property
    def confidence(self) -> float:
        """Shown share of what is not hidden, in [0, 1].

        It shrinks towards 0 where little is shown: points inside the table contradict nothing.
        """
        share = self.shown / max(self.shown + self.missing, 1e-9)
        return share * min(1.0, self.shown / MIN_SHOWN)


def evidence(points_world: np.ndarray, views: Sequence[View]) -> Evidence:
    """Ask all cameras about points (N, 3), N >= 1."""
    shown = np.zeros(len(points_world), dtype=bool)
    missing = np.zeros(len(points_world), dtype=bool)
    for view in views:
        camera = view.camera
        uv, z = project(points_world, camera.K, camera.T_world_camera)
        size = np.array([camera.width, camera.height])
        with np.errstate(invalid="ignore"):
            inside = (z > 0) & (uv >= -0.5).all(axis=1) & (uv < size - 0.5).all(axis=1)
        column, row = np.floor(uv[inside] + 0.5).astype(np.intp).T
        reading = view.depth_m[row, column]
        beyond = reading - z[inside]
        there = np.flatnonzero(inside)
        shown[there[(reading > 0) & (np.abs(beyond) <= AGREES_M)]] = True
        missing[there[(reading > 0) & (beyond > AGREES_M)]] = True
    return Evidence(float(shown.mean()), float((missing & ~shown).mean()))


def fit_rigid(points: np.ndarray, target: cKDTree, T_guess: np.ndarray) -> np.ndarray:
    """Move points (N, 3) onto a cloud, beginning from a guess; returns (4, 4) float64.

    Iterated closest points on the best share of the pairs.

    Source: Chetverikov et al., The Trimmed Iterative Closest Point Algorithm, ICPR 2002.
    """
    T = T_guess
    for _ in range(ROUNDS):
        moved = apply_transform(T, points)
        distance, nearest = target.query(moved)
        kept = distance <= np.quantile(distance, KEPT)
        step = _align(moved[kept], np.asarray(target.data)[nearest[kept]])
        T = step @ T
        if np.abs(step - np.eye(4)).max() < STILL:
            break
    return T


def _align(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The rigid motion (4, 4) that brings paired points (N, 3) nearest to each other.

    Source: Kabsch, A solution for the best rotation to relate two sets of vectors, 1976.
    """
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - middle).T @ (target - goal))
    keep = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    R = vt.T @ keep @ u.T
    return make_transform(R, goal - R @ middle)
