"""Whether bodies of a scene run into each other, by their true convex parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linprog

from codediffuser.datagen.scene import ObjectSpec, SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.poses import apply_transform

KEPT_BODIES = 500
"""Bodies that are remembered; mugs of drawn shapes hardly ever come twice."""


@dataclass(frozen=True, slots=True)
class _Part:
    """A convex part: corners (V, 3) and outward face normals (F, 3), float64."""

    corners: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True, slots=True)
class _Placed:
    """A part in the world, with its box."""

    part: _Part
    low: np.ndarray
    high: np.ndarray


class OverlapChecker:
    """Finds overlaps of one task's scenes; bodies that look alike are built once.

    Args:
        task: Gives the bodies.
        tolerance_m: Bodies that rest on or lean against each other touch; less than this is no
            overlap.
    """

    def __init__(self, task: Task, tolerance_m: float = 0.0002) -> None:
        self._task = task
        self._tolerance = tolerance_m
        self._bodies: dict[tuple[object, ...], tuple[_Part, ...]] = {}

    def overlaps(self, scene: SceneSpec) -> Iterator[tuple[str, str]]:
        """Yield the ids of each two bodies that overlap; two fixed ones are built to touch."""
        placed = {o.id: self._place(o) for o in scene.objects}
        fixed = {o.id for o in scene.objects if o.fixed}
        for one, other in combinations(placed, 2):
            if one in fixed and other in fixed:
                continue
            if any(
                self._near(a, b) and not _apart(a.part, b.part, self._tolerance)
                for a in placed[one]
                for b in placed[other]
            ):
                yield one, other

    def below_table(self, scene: SceneSpec) -> list[str]:
        """Ids of bodies that reach through the table's top, z = 0."""
        return [
            o.id for o in scene.objects if any(p.low[2] < -self._tolerance for p in self._place(o))
        ]

    def _place(self, obj: ObjectSpec) -> list[_Placed]:
        T = obj.T_world_object
        found = []
        for part in self._parts(obj):
            corners = apply_transform(T, part.corners)
            found.append(
                _Placed(
                    _Part(corners, part.normals @ T[:3, :3].T),
                    corners.min(axis=0),
                    corners.max(axis=0),
                )
            )
        return found

    def _parts(self, obj: ObjectSpec) -> tuple[_Part, ...]:
        key = (
            obj.category, obj.fixed, obj.place is None, obj.label,
            obj.color_rgb if obj.label else None, *sorted(obj.shape.items()),
        )  # fmt: skip
        if key not in self._bodies:
            if len(self._bodies) >= KEPT_BODIES:
                self._bodies.clear()
            self._bodies[key] = tuple(
                _Part(
                    np.asarray(mesh.vertices, dtype=np.float64),
                    np.unique(np.round(mesh.face_normals, 9), axis=0),
                )
                for mesh in self._task.geometry(obj).collision
            )
        return self._bodies[key]

    def _near(self, a: _Placed, b: _Placed) -> bool:
        deep = self._tolerance
        return bool(np.all(a.low < b.high - deep) and np.all(b.low < a.high - deep))


def _apart(a: _Part, b: _Part, tolerance_m: float) -> bool:
    """Whether a plane parts two convex bodies, but for the tolerance.

    Planes along faces come first, since they nearly always do; a linear programme decides the rest.
    """
    axes = np.concatenate([a.normals, b.normals])
    on_a, on_b = axes @ a.corners.T, axes @ b.corners.T
    gaps = np.maximum(on_b.min(axis=1) - on_a.max(axis=1), on_a.min(axis=1) - on_b.max(axis=1))
    return bool(gaps.max() >= -tolerance_m) or _plane_between(a.corners, b.corners)


def _plane_between(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether some plane n x = d has all of `a` on one side and all of `b` on the other.

    Maximises t with n a - d >= t, d - n b >= t and every |n_i| <= 1.
    """
    ones_a, ones_b = np.ones((len(a), 1)), np.ones((len(b), 1))
    rows = np.concatenate([np.hstack([-a, ones_a, ones_a]), np.hstack([b, -ones_b, ones_b])])
    solved = linprog(
        [0, 0, 0, 0, -1], A_ub=rows, b_ub=np.zeros(len(rows)),
        bounds=[(-1, 1)] * 3 + [(None, None), (None, 1)],
    )  # fmt: skip
    return bool(solved.success and solved.x[4] > 1e-9)
