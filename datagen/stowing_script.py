"""The motion that takes a book from the pad into a slot: grasp its spine, push in, press flush.

The hand is pitched: it looks away from the robot and down. Its fingers hold the book by the covers,
close to the spine, so that they never reach in between the books of the row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.book_slots import free_between, row_beside
from codediffuser.datagen.bookshelf import BooksConfig, ShelfConfig
from codediffuser.datagen.ranges import Range
from codediffuser.datagen.scene import ObjectSpec, Vector3
from codediffuser.datagen.task import Move, SceneView
from codediffuser.poses import invert_transform, make_transform, rotation_z
from codediffuser.schema import Strict

PADS_M = 0.1034
"""From the frame of `panda_hand` to the middle of the finger pads."""
FINGERTIP_M = 0.0124
"""How far the fingers reach beyond the middle of their pads."""


class StowingScriptConfig(Strict):
    """Ranges of what varies between demonstrations, and what does not."""

    hand_pitch_rad: Range
    """How far the hand looks down from the horizontal."""
    standoff_m: Range
    """Between the spine and the fingers before they advance."""
    approach_up_m: Range
    """How far above the place where it advances from the hand arrives first."""
    approach_side_m: Range
    """How far the approach comes from the side."""
    grasp_yaw_rad: Range
    grasp_height_m: Range
    """Of the finger pads above the base of the book."""
    grip_depth_m: Range
    """How far the finger pads reach in from the spine."""
    lift_m: Range
    front_gap_m: Range
    """Between the leading edge of the book and the row before it is pushed in."""
    place_yaw_rad: Range
    carry_clearance_m: float
    """Between the book's base and the floor of the shelf while it is pushed in."""
    wedge_depth_m: float
    """How deep the book goes in while it moves over to its place and pushes neighbours aside."""
    firm_clearance_m: float
    """Kept to a neighbour that stands, while pushing."""
    release_gap_m: float
    """Between the fingertips and the spines of the row when the fingers open."""
    push_height_m: Range
    """Of the closed fingertips above the floor of the shelf, when they press the book flush."""
    press_beyond_m: float
    """How far the press is commanded beyond the last place, against what resists."""
    speed: Range
    """Factor on the speed of every demonstration."""
    home_m: Vector3
    """Where the hand begins and ends: beside the pad, out of the view of the shelf."""
    home_yaw_rad: float
    home_pitch_rad: float
    open_m: float


def hand_rotation(yaw_rad: float, pitch_rad: float) -> np.ndarray:
    """Rotation (3, 3) of a hand that looks along +y and down; its fingers open along world x."""
    forward = np.array([0.0, np.cos(pitch_rad), -np.sin(pitch_rad)])
    fingers = np.array([1.0, 0.0, 0.0])
    return rotation_z(yaw_rad) @ np.stack([np.cross(fingers, forward), fingers, forward], axis=1)


def hand_with_pads_at(point_m: np.ndarray, R_world_hand: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of `panda_hand` that brings the middle of the finger pads to a world point."""
    return make_transform(R_world_hand, point_m - PADS_M * R_world_hand[:, 2])


@dataclass(frozen=True, slots=True)
class Way:
    """How a book goes into a slot: middles of its base in world x."""

    enter_x_m: float
    """Where its leading edge enters."""
    stow_x_m: float
    """Where it stays."""


class StowingScript:
    """One demonstration: draws its variation first, then plans move by move from what it sees.

    Args:
        config: Ranges.
        shelf: Where the shelf is.
        books: Sizes that all books share.
        view: The present state.
        rng: The only source of chance.
    """

    def __init__(
        self, config: StowingScriptConfig, shelf: ShelfConfig, books: BooksConfig, view: SceneView,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self._c, self._shelf, self._books, self._view = config, shelf, books, view
        self._book = view.scene.object(view.scene.target.pick)
        self._place = view.scene.place(view.scene.target.place)
        self._pitch = rng.uniform(*config.hand_pitch_rad)
        self._standoff = rng.uniform(*config.standoff_m)
        self._up = rng.uniform(*config.approach_up_m)
        self._side = rng.uniform(*config.approach_side_m)
        self._grasp_yaw = rng.uniform(*config.grasp_yaw_rad)
        self._grasp_height = rng.uniform(*config.grasp_height_m)
        self._grip = rng.uniform(*config.grip_depth_m)
        self._lift = rng.uniform(*config.lift_m)
        self._front_gap = rng.uniform(*config.front_gap_m)
        self._place_yaw = rng.uniform(*config.place_yaw_rad)
        self._push_height = rng.uniform(*config.push_height_m)
        self._speed = rng.uniform(*config.speed)

    def moves(self) -> Iterator[Move]:
        """All moves, from the pad to the shelf and home."""
        yield from self._take()
        yield from self._carry()
        yield from self._stow()
        yield from self._press()
        yield self._move("home", self._home(), 25, self._c.open_m)

    def _take(self) -> Iterator[Move]:
        T_world_book = self._view.T_world_object(self._book.id)
        R_world_hand = T_world_book[:3, :3] @ hand_rotation(self._grasp_yaw, self._pitch)
        half_depth, height = self._books.depth_m / 2, self._grasp_height

        def hand(x: float, behind: float) -> np.ndarray:
            point = T_world_book @ np.array([x, -half_depth - behind, height, 1.0])
            return hand_with_pads_at(point[:3], R_world_hand)

        grasp = hand(0.0, -self._grip)
        above = _moved(hand(self._side, self._standoff), z=self._up)
        yield self._move("approach", above, 25, self._c.open_m)
        yield self._move("approach", hand(0.0, self._standoff), 10, self._c.open_m)
        yield self._move("reach", grasp, 12, self._c.open_m)
        yield self._move("grasp", grasp, 10, 0.0)
        yield self._move("lift", _moved(grasp, z=self._lift), 12, 0.0)

    def _carry(self) -> Iterator[Move]:
        """Turn the book to face the shelf, and bring it in front of where it enters."""
        depth, way = self._books.depth_m, self._way()
        ready_y = self._shelf.spine_y_m - self._front_gap - depth / 2
        carried_z = self._shelf.floor_m + self._lift
        now = self._view.T_world_object(self._book.id)
        # Turned on the spot, clear of the row; then across, then down in front of the slot.
        back = np.array([now[0, 3], min(now[1, 3], ready_y) - 0.02, now[2, 3]])
        yield self._carry_move("turn", back, 16, yaw=self._place_yaw)
        yield self._carry_move("align", np.array([way.enter_x_m, ready_y - 0.02, carried_z]), 25)
        low_z = self._shelf.floor_m + self._c.carry_clearance_m
        yield self._carry_move("align", np.array([way.enter_x_m, ready_y, low_z]), 12)
        # Once more from where the book really is: it may have slipped a little in the hand.
        yield self._carry_move("align", np.array([way.enter_x_m, ready_y, low_z]), 6)

    def _stow(self) -> Iterator[Move]:
        c, shelf, way = self._c, self._shelf, self._way()
        half, low_z = self._books.depth_m / 2, shelf.floor_m + c.carry_clearance_m
        across = self._books.bevel_m[1]

        def at(x: float, leading_depth: float, z: float = low_z) -> np.ndarray:
            return np.array([x, shelf.spine_y_m + leading_depth - half, z])

        yield self._carry_move("push", at(way.enter_x_m, across), 10)
        yield self._carry_move("push", at(way.stow_x_m, c.wedge_depth_m), 20)
        tips = self._grip + FINGERTIP_M + c.release_gap_m
        last = self._books.depth_m - tips
        yield self._carry_move("insert", at(way.stow_x_m, last), 24)
        down = at(way.stow_x_m, last, shelf.floor_m + 0.001)
        yield self._carry_move("insert", down, 6)
        held = self._hand_for(down)
        yield self._move("release", held, 8, c.open_m)
        yield self._move("retreat", _moved(held, y=-tips - 0.03), 10, c.open_m)

    def _press(self) -> Iterator[Move]:
        """Press the book in with closed fingers, until its spine lies in the row."""
        x, y = self._view.T_world_object(self._book.id)[:2, 3]
        R_world_hand = hand_rotation(0.0, self._pitch)
        spine_y = self._shelf.spine_y_m + self._c.press_beyond_m
        reach = FINGERTIP_M * R_world_hand[:, 2]

        def hand(behind: float) -> np.ndarray:
            tip = np.array([x, spine_y - behind, self._shelf.floor_m + self._push_height])
            return hand_with_pads_at(tip - reach, R_world_hand)

        protrudes = self._shelf.spine_y_m + self._books.depth_m / 2 - y
        yield self._move("press", hand(protrudes + 0.03), 14, 0.0)
        yield self._move("press", hand(0.0), 22, 0.0)
        yield self._move("retreat", hand(0.08), 10, self._c.open_m)

    def _way(self) -> Way:
        """Where the book enters the slot, and where it stays, from the neighbours as they are."""
        view, thickness = self._view, self._book.shape["thickness_m"]
        left, right = row_beside(view.scene, self._place.id)
        poses = [_pose_now(view, o) for o in (left[-1], right[0])]
        low = self._shelf.floor_m
        a, b = free_between(
            left[-1], poses[0], right[0], poses[1], (low, low + self._book.shape["height_m"])
        )
        stow = (a + b) / 2
        half = thickness / 2 + self._c.firm_clearance_m
        if poses[0][2, 2] > 0.9995:
            stow = max(stow, a + half)
        elif poses[1][2, 2] > 0.9995:
            stow = min(stow, b - half)
        return Way((a + b) / 2, stow)

    def _carry_move(
        self, phase: str, middle_m: np.ndarray, steps: int, yaw: float | None = None
    ) -> Move:
        return self._move(phase, self._hand_for(middle_m, yaw), steps, 0.0)

    def _hand_for(self, middle_m: np.ndarray, yaw: float | None = None) -> np.ndarray:
        """Hand pose that brings the middle of the held book's base to a point, upright."""
        T_book_hand = invert_transform(self._view.T_world_object(self._book.id)) @ (
            self._view.T_world_hand()
        )
        R_world_book = rotation_z(self._place_yaw if yaw is None else yaw)
        return make_transform(R_world_book, middle_m) @ T_book_hand

    def _home(self) -> np.ndarray:
        R_world_hand = hand_rotation(self._c.home_yaw_rad, self._c.home_pitch_rad)
        return make_transform(R_world_hand, np.array(self._c.home_m))

    def _move(self, phase: str, T_world_hand: np.ndarray, steps: int, gripper_m: float) -> Move:
        return Move(phase, T_world_hand, max(2, round(steps / self._speed)), gripper_m)


def _pose_now(view: SceneView, obj: ObjectSpec) -> np.ndarray:
    return obj.T_world_object if obj.fixed else view.T_world_object(obj.id)


def _moved(T: np.ndarray, *, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    moved = T.copy()
    moved[:3, 3] += (0.0, y, z)
    return moved
