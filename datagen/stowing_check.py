"""When a book counts as stowed, and what went wrong when it does not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datagen.book_slots import middle_x_m, row_beside, shelved_books
from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec
from codediffuser.datagen.task import Check, Condition, SceneView
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.datagen.views import TrajectoryView
from codediffuser.schema import Strict

LIFTED_M = 0.02
PHASES = {
    "beside_m": "push:wrong_slot",
    "row_shift_m": "push:row_disturbed",
    "upright": "insert:tilted",
    "spine_out": "insert:tilted",
    "base_height_m": "insert:tilted",
    "depth_error_m": "press:not_flush",
}
"""Condition to the phase that a book on the shelf fails in, the gravest first."""


class SuccessConfig(Strict):
    """Thresholds of `check_success`."""

    min_beside_m: float
    """Between the middles of the book and of its neighbours, along the shelf."""
    min_upright: float
    min_spine_out: float
    """Cosine of the angle between the spine and the plane of the row."""
    max_depth_error_m: float
    """Between the book and the row, along the depth of the shelf."""
    max_base_height_m: float
    """Of the book above the floor of the shelf."""
    max_row_shift_m: float
    """How far any book of the row may have moved out of line."""
    min_opening_m: float
    min_hand_distance_m: float
    max_speed_mps: float
    max_spin_radps: float


def check_stowed(
    limits: SuccessConfig, floor_m: float, view: SceneView, pairs: Sequence[Pair]
) -> Check:
    """Judge the pair whose slot the book is deepest inside of.

    Args:
        limits: Thresholds.
        floor_m: Height of the shelf's floor.
        view: The state to judge.
        pairs: Allowed books and slots.
    """
    judged = [Check(pair, _conditions(limits, floor_m, view, pair)) for pair in pairs]
    if not judged:
        return Check(None, ())
    return max(judged, key=lambda c: (c.success, c.conditions[0].value))


def _conditions(
    limits: SuccessConfig, floor_m: float, view: SceneView, pair: Pair
) -> tuple[Condition, ...]:
    scene = view.scene
    T, book = view.T_world_object(pair[0]), scene.object(pair[0])
    row_y = scene.place(pair[1]).position_m[1]
    moved = [view.T_world_object(o.id)[1, 3] for o in shelved_books(scene) if not o.fixed]
    shift = max((abs(float(y) - row_y) for y in moved), default=0.0)
    opening = view.gripper_opening_m()
    middle = T[:3, 3] + T[:3, 2] * book.shape["height_m"] / 2
    hand_away = float(np.linalg.norm(view.T_world_hand()[:3, 3] - middle))
    released = opening > limits.min_opening_m or hand_away > limits.min_hand_distance_m
    speed, spin = view.object_speed(pair[0])
    at_least = [
        ("beside_m", _beside_m(view, pair), limits.min_beside_m),
        ("upright", float(T[2, 2]), limits.min_upright),
        ("spine_out", float(T[1, 1]), limits.min_spine_out),
    ]
    at_most = [
        ("depth_error_m", abs(float(T[1, 3]) - row_y), limits.max_depth_error_m),
        ("base_height_m", abs(float(T[2, 3]) - floor_m), limits.max_base_height_m),
        ("row_shift_m", shift, limits.max_row_shift_m),
        ("speed_mps", speed, limits.max_speed_mps),
        ("spin_radps", spin, limits.max_spin_radps),
    ]
    return (
        *(Condition(name, value, limit, value > limit) for name, value, limit in at_least),
        *(Condition(name, value, limit, value < limit) for name, value, limit in at_most),
        Condition("released_opening_m", opening, limits.min_opening_m, released),
    )


def _beside_m(view: SceneView, pair: Pair) -> float:
    """How far the book stays off all that stood left of the slot, and all on its right."""
    left, right = row_beside(view.scene, pair[1])

    def now(obj: ObjectSpec) -> float:
        return middle_x_m(obj.T_world_object if obj.fixed else view.T_world_object(obj.id), obj)

    x = now(view.scene.object(pair[0]))
    return min(x - max(now(o) for o in left), min(now(o) for o in right) - x)


def stowing_failure(
    limits: SuccessConfig, floor_m: float, scene: SceneSpec, trajectory: Trajectory,
    pairs: Sequence[Pair],
) -> str:  # fmt: skip
    """Phase and what happened in it, for a trajectory that did not succeed."""
    waiting = scene.pickable[0]
    heights = trajectory.object_position_m[:, trajectory.object_ids.index(waiting.id), 2]
    T = trajectory.T_world_object(waiting.id, -1)
    if heights.max() - heights[0] < LIFTED_M:
        return "grasp:tipped" if T[2, 2] < 0.9 else "grasp:missed"
    check = check_stowed(limits, floor_m, TrajectoryView(scene, trajectory), pairs)
    failed = {c.name for c in check.conditions if not c.holds}
    on_shelf = float(T[1, 3]) > scene.places[0].position_m[1] - waiting.shape["depth_m"] / 2
    if "released_opening_m" in failed:
        return "release:not_released" if on_shelf else "transport:timeout"
    if not on_shelf:
        stands = T[2, 3] > floor_m - limits.max_base_height_m and T[2, 2] > 0.9
        return "push:blocked" if stands else "transport:dropped"
    return next((p for name, p in PHASES.items() if name in failed), "release:not_at_rest")
