"""From one commanded hand pose to the next: smooth motion, one action per control step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.task import Move
from codediffuser.poses import (
    matrix_to_quat_wxyz,
    matrix_to_rot6d,
    quat_wxyz_to_matrix,
    rot6d_to_matrix,
)

if TYPE_CHECKING:
    from codediffuser.datagen.views import Moment


@dataclass(frozen=True, slots=True)
class Command:
    """What the hand was last told: the start of the next move."""

    position_m: np.ndarray
    """(3,) float64, world."""
    quat_wxyz: np.ndarray
    """(4,) float64."""
    gripper_m: float


def held_command(moment: Moment) -> Command:
    """Command that keeps the hand where it is."""
    return Command(moment.hand_position_m, moment.hand_quat_wxyz, float(moment.qpos[-2:].mean()))


def end_command(move: Move) -> Command:
    """Command at the end of a move."""
    T = move.T_world_hand
    return Command(T[:3, 3], matrix_to_quat_wxyz(T[:3, :3]), move.gripper_m)


def command_of(action: np.ndarray) -> Command:
    """The command that an action (10,) stands for."""
    R_world_hand = rot6d_to_matrix(action[3:9].astype(np.float64))
    return Command(
        action[:3].astype(np.float64), matrix_to_quat_wxyz(R_world_hand), float(action[9])
    )


def interpolate(start: Command, move: Move) -> np.ndarray:
    """Actions (steps, 10) float32 from a command to the end of a move.

    Position and rotation follow a smoothstep, at rest at both ends; the gripper moves evenly.
    The start itself is left out, the end is the last row.
    """
    end = end_command(move)
    even = np.arange(1, move.steps + 1) / move.steps
    smooth = even**2 * (3 - 2 * even)
    position = start.position_m + smooth[:, None] * (end.position_m - start.position_m)
    rotation = quat_wxyz_to_matrix(slerp(start.quat_wxyz, end.quat_wxyz, smooth))
    gripper = start.gripper_m + even * (end.gripper_m - start.gripper_m)
    actions = np.concatenate([position, matrix_to_rot6d(rotation), gripper[:, None]], axis=-1)
    return actions.astype(np.float32)


def slerp(start_wxyz: np.ndarray, end_wxyz: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4) on the shorter great arc from start (4,) to end (4,).

    Source: Shoemake, Animating rotation with quaternion curves, 1985.
    """
    cosine = float(start_wxyz @ end_wxyz)
    if cosine < 0:
        end_wxyz, cosine = -end_wxyz, -cosine
    angle = float(np.arccos(min(cosine, 1.0)))
    t = np.asarray(fractions)[:, None]
    if angle < 1e-6:
        mixed = (1 - t) * start_wxyz + t * end_wxyz
    else:
        mixed = np.sin((1 - t) * angle) * start_wxyz + np.sin(t * angle) * end_wxyz
    return mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)
