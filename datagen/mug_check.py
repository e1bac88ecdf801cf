"""When a mug hangs on its branch, and at which step an attempt to hang it went wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datagen.mug_shapes import MugShape, passes_handle
from codediffuser.datagen.mug_tree import tree_branches, tree_of
from codediffuser.datagen.scene import Pair, SceneSpec
from codediffuser.datagen.task import Check, Condition, SceneView
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.datagen.views import TrajectoryView
from codediffuser.schema import Strict

LIFTED_M = 0.03
"""A mug that has risen by this much was lifted."""

NEAR_BRANCH_M = 0.12
"""A mug that came this near to the place of a branch was to be hung there."""

UPRIGHT = 0.9
"""Cosine of the lean at which a mug still counts as standing."""


class SuccessConfig(Strict):
    """Thresholds of `check_success`."""

    max_dx_m: float
    """Between the mug's middle and the place on the branch, along x."""
    max_below_branch_m: float
    """How far the mug's middle may lie below that place."""
    min_above_table_m: float
    """Of the lowest point of the mug's body."""
    min_opening_m: float
    min_hand_distance_m: float
    max_speed_mps: float
    max_spin_radps: float


def check_hung(
    limits: SuccessConfig, hang_m: float, view: SceneView, pairs: Sequence[Pair]
) -> Check:
    """Judge the pair that most conditions hold for.

    Args:
        limits: Thresholds.
        hang_m: Where on a branch its place is, from the trunk's axis.
        view: The state.
        pairs: Mugs and branches that are allowed.
    """
    judged = [Check(pair, _conditions(limits, hang_m, view, pair)) for pair in pairs]
    if not judged:
        return Check(None, ())
    return max(judged, key=lambda c: (sum(x.holds for x in c.conditions), -c.conditions[0].value))


def _conditions(
    limits: SuccessConfig, hang_m: float, view: SceneView, pair: Pair
) -> tuple[Condition, ...]:
    mug_id, branch_id = pair
    T = view.T_world_object(mug_id)
    hang = tree_branches(tree_of(view.scene))[branch_id].at(hang_m)
    dx, below = abs(float(T[0, 3] - hang[0])), float(hang[2] - T[2, 3])
    around = branches_in_handle(view, mug_id) == [branch_id]
    above = MugShape.of(view.scene.object(mug_id).shape).lowest_z_m(T)
    speed, spin = view.object_speed(mug_id)
    return (
        Condition("dx_m", dx, limits.max_dx_m, dx < limits.max_dx_m),
        Condition(
            "below_branch_m", below, limits.max_below_branch_m,
            0 <= below <= limits.max_below_branch_m,
        ),
        Condition("around_branch", float(around), 1.0, around),
        Condition(
            "above_table_m", above, limits.min_above_table_m, above > limits.min_above_table_m
        ),
        Condition(
            "released_opening_m", view.gripper_opening_m(), limits.min_opening_m,
            _released(limits, view, mug_id),
        ),
        Condition("speed_mps", speed, limits.max_speed_mps, speed < limits.max_speed_mps),
        Condition("spin_radps", spin, limits.max_spin_radps, spin < limits.max_spin_radps),
    )  # fmt: skip


def _released(limits: SuccessConfig, view: SceneView, mug_id: str) -> bool:
    away = view.T_world_hand()[:3, 3] - view.T_world_object(mug_id)[:3, 3]
    return (
        view.gripper_opening_m() > limits.min_opening_m
        or float(np.linalg.norm(away)) > limits.min_hand_distance_m
    )


def branches_in_handle(view: SceneView, mug_id: str) -> list[str]:
    """Names of the branches, used or not, whose axis runs through a mug's handle."""
    T, shape = view.T_world_object(mug_id), MugShape.of(view.scene.object(mug_id).shape)
    return [
        name
        for name, branch in tree_branches(tree_of(view.scene)).items()
        if passes_handle(shape, T, branch.at(0.0), branch.at(branch.length_m))
    ]


def hanging_failure(
    limits: SuccessConfig, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]
) -> str:
    """Phase and what happened in it: `grasp:missed`, `insert:missed_branch`, ..."""
    mugs = [o.id for o in scene.pickable]
    rows = [trajectory.object_ids.index(i) for i in mugs]
    heights = trajectory.object_position_m[:, rows, 2]
    rise = (heights - heights[0]).max(axis=0)
    if rise.max() < LIFTED_M:
        upright = min(trajectory.T_world_object(i, -1)[2, 2] for i in mugs)
        return "grasp:tipped" if upright < UPRIGHT else "grasp:missed"
    handled = mugs[int(np.argmax(rise))]
    if handled not in {pick for pick, _ in pairs}:
        return "grasp:wrong_object"
    end = TrajectoryView(scene, trajectory)
    on = branches_in_handle(end, handled)
    if not _released(limits, end, handled):
        return "release:not_released" if on else "transport:timeout"
    if on:
        allowed = len(on) == 1 and (handled, on[0]) in pairs
        return "release:not_at_rest" if allowed else "place:wrong_branch"
    return _how_it_fell(scene, trajectory, handled)


def _how_it_fell(scene: SceneSpec, trajectory: Trajectory, mug_id: str) -> str:
    views = [TrajectoryView(scene, trajectory, k) for k in range(trajectory.num_steps + 1)]
    if any(branches_in_handle(view, mug_id) for view in views):
        return "release:fell_off"
    path = trajectory.object_position_m[:, trajectory.object_ids.index(mug_id)]
    places = np.array([place.position_m for place in scene.places])
    nearest = np.linalg.norm(path[:, None] - places, axis=-1).min()
    return "insert:missed_branch" if nearest < NEAR_BRANCH_M else "transport:dropped"
