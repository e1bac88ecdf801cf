"""When a battery counts as packed, and what went wrong when it does not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datagen.scene import Pair, SceneSpec
from codediffuser.datagen.task import Check, Condition, SceneView
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.schema import Strict


class SuccessConfig(Strict):
    """Thresholds of `check_success`."""

    max_xy_m: float
    min_upright: float
    max_base_height_m: float
    min_opening_m: float
    min_hand_distance_m: float
    max_speed_mps: float
    max_spin_radps: float


def check_packed(limits: SuccessConfig, view: SceneView, pairs: Sequence[Pair]) -> Check:
    """Judge the pair whose battery is nearest to its slot: standing in it, released, at rest."""
    judged = [Check(pair, _conditions(limits, view, pair)) for pair in pairs]
    if not judged:
        return Check(None, ())
    return max(judged, key=lambda c: (c.success, -c.conditions[0].value))


def _conditions(limits: SuccessConfig, view: SceneView, pair: Pair) -> tuple[Condition, ...]:
    T = view.T_world_object(pair[0])
    slot = np.array(view.scene.place(pair[1]).position_m)
    xy = float(np.linalg.norm(T[:2, 3] - slot[:2]))
    upright, height = float(T[2, 2]), float(T[2, 3])
    opening = view.gripper_opening_m()
    hand_away = float(np.linalg.norm(view.T_world_hand()[:3, 3] - T[:3, 3]))
    speed, spin = view.object_speed(pair[0])
    released = opening > limits.min_opening_m or hand_away > limits.min_hand_distance_m
    return (
        Condition("xy_distance_m", xy, limits.max_xy_m, xy < limits.max_xy_m),
        Condition("upright", upright, limits.min_upright, upright > limits.min_upright),
        Condition(
            "base_height_m", height, limits.max_base_height_m, height < limits.max_base_height_m
        ),
        Condition("released_opening_m", opening, limits.min_opening_m, released),
        Condition("speed_mps", speed, limits.max_speed_mps, speed < limits.max_speed_mps),
        Condition("spin_radps", spin, limits.max_spin_radps, spin < limits.max_spin_radps),
    )


def packing_failure(
    limits: SuccessConfig,
    pitch_m: float,
    scene: SceneSpec,
    trajectory: Trajectory,
    pairs: Sequence[Pair],
) -> str:
    """Phase and what happened in it: `grasp:missed`, `transport:dropped`, `place:on_rim`."""
    positions = trajectory.object_position_m
    rise = (positions[:, :, 2] - positions[0, :, 2]).max(axis=0)
    waiting = [o.id for o in scene.pickable]
    lifted = [i for i in waiting if rise[trajectory.object_ids.index(i)] > 0.03]
    wanted = {pick for pick, _ in pairs}
    if not lifted:
        ends = [trajectory.T_world_object(i, -1)[2, 2] for i in waiting]
        return "grasp:tipped" if min(ends) < 0.9 else "grasp:missed"
    handled = max(lifted, key=lambda i: rise[trajectory.object_ids.index(i)])
    if handled not in wanted:
        return "grasp:wrong_object"
    T = trajectory.T_world_object(handled, -1)
    hand_away = np.linalg.norm(trajectory.T_world_hand(-1)[:3, 3] - T[:3, 3])
    opening = float(trajectory.qpos[-1, 7:].mean())
    if hand_away < limits.min_hand_distance_m and opening < limits.min_opening_m:
        return "transport:timeout" if T[2, 3] > 0.05 else "release:not_released"
    distances = {
        p.id: float(np.linalg.norm(T[:2, 3] - np.array(p.position_m[:2]))) for p in scene.places
    }
    nearest = min(distances, key=lambda name: distances[name])
    if distances[nearest] > pitch_m:
        return "transport:dropped"
    if T[2, 3] >= limits.max_base_height_m or T[2, 2] <= limits.min_upright:
        return "place:on_rim"
    return "place:wrong_slot" if (handled, nearest) not in pairs else "release:not_at_rest"
