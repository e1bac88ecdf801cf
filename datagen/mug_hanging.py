"""The expert of `hang_mug`: how a mug is taken by its sides and its handle led over a branch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from codediffuser.datagen.mug_shapes import MugShape
from codediffuser.datagen.mug_tree import Branch
from codediffuser.datagen.ranges import Range
from codediffuser.datagen.scene import Vector3
from codediffuser.datagen.task import Move, SceneView
from codediffuser.poses import invert_transform, make_transform, rotation_z
from codediffuser.schema import Strict

R_WORLD_HAND_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""The hand points down and its fingers open along world x."""

FINGER_REACH_M = 0.1124
"""From the origin of `panda_hand` to the tips of the fingers."""

CLOSED_M = 0.0

LOST_M = 0.03
"""A mug that has moved this far in the hand since it was lifted is no longer held."""


class StepsConfig(Strict):
    """Control steps of each phase at slowness 1."""

    approach: int
    descend: int
    grasp: int
    lift: int
    carry: int
    """For every 0.1 m sideways."""
    transport: int
    align: int
    insert: int
    lower: int
    release: int
    retreat: int
    home: int
    settle: int
    """The mug swings until it hangs still."""


class HangingConfig(Strict):
    """Ranges that each demonstration is drawn from, so that no two are one motion."""

    home_m: Vector3
    open_m: float
    hover_m: Range
    """Of the hand above its grasp, before it goes down."""
    grip_depth_m: Range
    """How far below the rim the finger tips reach."""
    grip_xy_m: float
    """The hand grasps up to this far beside the mug's axis, along x and along y."""
    grip_yaw_rad: float
    """The fingers close up to this far from square to the handle."""
    lift_z_m: Range
    """Height of the hand at which a mug is carried off."""
    place_yaw_rad: float
    """The handle's plane stands up to this far from square to the branch."""
    tilt_rad: Range
    """How far the hand leans back, toward where the mug will hang; upright it would swing long. A
    mug that has sunk in the hand leans less, so that the arm stays clear of its limits."""
    before_tip_m: Range
    """Where the handle's middle meets the branch's line, before the tip."""
    over_line_m: Range
    """How far above that line the mug arrives."""
    hang_along_m: Range
    """Where on the branch the mug is let go, from the trunk's axis."""
    rest_gap_m: Range
    """Between the handle and the branch when the mug is let go."""
    retreat_m: Range
    slowness: Range
    """Factor on the steps of each phase, drawn for each."""
    steps: StepsConfig


@dataclass(frozen=True, slots=True)
class HangingPlan:
    """How the mug is held against the branch: what stays the same from transport to release."""

    branch: Branch
    shape: MugShape
    R_world_mug: np.ndarray
    """(3, 3) orientation of the mug while its handle is led over the branch."""

    def T_world_mug(self, along_m: float, up_m: float = 0.0) -> np.ndarray:
        """Pose (4, 4) at which a point of the branch's line meets the middle of the opening.

        Args:
            along_m: Where on the line, from the trunk's axis.
            up_m: How far the mug is lifted from there.
        """
        middle_mug = np.array([sum(self.shape.opening_x_m) / 2, 0.0, 0.0])
        point = self.branch.at(along_m) + np.array([0.0, 0.0, up_m])
        return make_transform(self.R_world_mug, point - self.R_world_mug @ middle_mug)

    def slack_m(self, branch_radius_m: float) -> float:
        """How far the mug may sink until the handle's upper arm lies on the branch."""
        rise = np.hypot(*self.branch.direction[:2])
        return float(self.shape.opening_z_m[1] - branch_radius_m / rise)


def hang_mug_moves(
    view: SceneView,
    rng: np.random.Generator,
    config: HangingConfig,
    *,
    pick: str,
    shape: MugShape,
    branch: Branch,
    branch_radius_m: float,
) -> Iterator[Move]:
    """Yield the moves of one demonstration.

    The mug is grasped from above across its body, so that the handle stays free; carried sideways
    while still in front of the tree, since the straight way may lead through another branch;
    brought before the tip with its handle's plane square to the branch; led inward along the
    branch; let go.

    Args:
        view: The state, looked at again before each move that depends on how the mug is held.
        rng: Draws what varies.
        config: Ranges of it.
        pick: Id of the mug.
        shape: Its sizes.
        branch: Where it goes.
        branch_radius_m: Thickness of that branch.
    """
    steps = _draw_steps(rng, config)
    grip = _grip(view.T_world_object(pick), shape, rng, config)
    yield Move(
        "approach", _raised(grip, _draw(rng, config.hover_m)), steps["approach"], config.open_m
    )
    yield Move("descend", grip, steps["descend"], config.open_m)
    yield Move("grasp", grip, steps["grasp"], CLOSED_M)
    lift = _raised(grip, _draw(rng, config.lift_z_m) - grip[2, 3])
    yield Move("lift", lift, steps["lift"], CLOSED_M)

    R_world_mug = _hanging_rotation(view.T_world_object(pick), branch, rng, config)
    plan = HangingPlan(branch, shape, R_world_mug)

    T_held = invert_transform(view.T_world_object(pick)) @ view.T_world_hand()

    def hand(along_m: float, up_m: float = 0.0) -> np.ndarray:
        """Pose of the hand that brings the mug there, as it is held now."""
        T_mug_hand = invert_transform(view.T_world_object(pick)) @ view.T_world_hand()
        # A mug that was lost is not run after.
        lost = np.linalg.norm(T_mug_hand[:3, 3] - T_held[:3, 3]) > LOST_M
        return plan.T_world_mug(along_m, up_m) @ (T_held if lost else T_mug_hand)

    before = branch.length_m + _draw(rng, config.before_tip_m)
    hang = _draw(rng, config.hang_along_m)
    sink = -plan.slack_m(branch_radius_m) + _draw(rng, config.rest_gap_m)
    over = _draw(rng, config.over_line_m)
    beside = lift.copy()
    beside[0, 3] = hand(before, over)[0, 3]
    carry_steps = max(1, round(steps["carry"] * abs(beside[0, 3] - lift[0, 3]) / 0.1))
    yield Move("carry", beside, carry_steps, CLOSED_M)
    yield Move("transport", hand(before, over), steps["transport"], CLOSED_M)
    yield Move("align", hand(before), steps["align"], CLOSED_M)
    yield Move("insert", hand(hang), steps["insert"], CLOSED_M)
    let_go = hand(hang, sink)
    yield Move("lower", let_go, steps["lower"], CLOSED_M)
    yield Move("release", let_go, steps["release"], config.open_m)
    away = let_go.copy()
    away[:3, 3] -= _draw(rng, config.retreat_m) * let_go[:3, 2]
    yield Move("retreat", away, steps["retreat"], config.open_m)
    home = make_transform(R_WORLD_HAND_DOWN, np.array(config.home_m))
    yield Move("home", home, steps["home"], config.open_m)
    yield Move("settle", home, steps["settle"], config.open_m)


def _draw(rng: np.random.Generator, limits: Range) -> float:
    return float(rng.uniform(*limits))


def _draw_steps(rng: np.random.Generator, config: HangingConfig) -> Mapping[str, int]:
    return {
        phase: max(1, round(steps * _draw(rng, config.slowness)))
        for phase, steps in config.steps.model_dump().items()
    }


def _grip(
    T_world_mug: np.ndarray, shape: MugShape, rng: np.random.Generator, config: HangingConfig
) -> np.ndarray:
    """Pose of the hand that takes the mug from above, fingers on both sides of the handle.

    The hand looks the same after half a turn; the one nearer its rest is taken.
    """
    yaw = _yaw(T_world_mug[:3, 0]) - np.pi / 2 + rng.uniform(-1, 1) * config.grip_yaw_rad
    yaw = (yaw + np.pi / 2) % np.pi - np.pi / 2
    xy = T_world_mug[:2, 3] + rng.uniform(-1, 1, size=2) * config.grip_xy_m
    rim_z = T_world_mug[2, 3] + shape.height_m / 2
    z = rim_z - _draw(rng, config.grip_depth_m) + FINGER_REACH_M
    return make_transform(rotation_z(yaw) @ R_WORLD_HAND_DOWN, np.array([*xy, z]))


def _hanging_rotation(
    T_world_mug: np.ndarray, branch: Branch, rng: np.random.Generator, config: HangingConfig
) -> np.ndarray:
    """Orientation (3, 3) of the mug while its handle is led over a branch.

    The handle's plane is square to the branch, which leaves two sides: the body comes to the one
    nearer the robot, or, where both are alike, to the one that needs less of a turn.
    """
    along, now = _yaw(branch.direction), _yaw(T_world_mug[:3, 0])
    sides = (along + np.pi / 2, along - np.pi / 2)
    square = max(sides, key=lambda yaw: np.sin(yaw) + 0.1 * np.cos(yaw - now))
    yaw = square + rng.uniform(-1, 1) * config.place_yaw_rad
    # The arm leans back toward the robot with ease, and sideways not at all.
    tilt = _draw(rng, config.tilt_rad) * max(0.0, float(np.sin(square)))
    sunk = float(np.arcsin(np.clip(-T_world_mug[2, 0], -1, 1)))
    lean_axis = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    return np.asarray(Rotation.from_rotvec((tilt - sunk) * lean_axis).as_matrix() @ rotation_z(yaw))


def _yaw(direction: np.ndarray) -> float:
    return float(np.arctan2(direction[1], direction[0]))


def _raised(T_world_hand: np.ndarray, up_m: float) -> np.ndarray:
    raised = T_world_hand.copy()
    raised[2, 3] += up_m
    return raised
