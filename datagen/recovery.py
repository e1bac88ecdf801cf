"""Recovery demonstrations: the hand is pushed off its path once, and the expert makes it good.

What is recorded as action is what the expert commands: during the push still its own path, then the
way back from where the push has left the hand. So every recorded action is one to imitate, and the
states include some that undisturbed demonstrations never visit.

Source of the idea: Laskey et al., DART: Noise injection for robust imitation learning, CoRL 2017.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from codediffuser.datagen.scene import SeedKey, Vector3
from codediffuser.datagen.task import Move, Task
from codediffuser.errors import ConfigError
from codediffuser.poses import matrix_to_rot6d, rot6d_to_matrix
from codediffuser.schema import Document, Strict
from codediffuser.seeding import Stage, rng_for

RECOVERY = "recovery.json"
"""File name in an episode folder; absent when nothing was pushed."""

RECOVER = "recover"
"""Phase of the steps that lead back."""

OFFSET_M = (0.02, 0.05)
"""Length of a push."""

TURN_RAD = 0.25
"""Largest turn about each axis."""

STEPS = (4, 8)
"""Control steps that a push takes: 0.16 to 0.32 s."""

RECOVER_STEPS = 10
"""At least so many control steps lead back, so that the way back is no jerk."""


class Push(Strict):
    """One displacement of the hand, growing evenly while it lasts."""

    phase: str
    """Of the script; the push meets the first move of that phase that is long enough."""
    at: float = Field(ge=0, le=1)
    """When in that move it begins: 0 at once, 1 as late as it still fits."""
    steps: int = Field(ge=1)
    offset_m: Vector3
    """World."""
    rotation_rad: Vector3
    """Rotation vector, world axes."""
    recover_steps: int = Field(ge=1)

    def fits(self, move: Move) -> bool:
        """Whether this is a move that the push can meet."""
        return move.phase == self.phase and move.steps > self.steps

    def start(self, move: Move) -> int:
        """Step of the move at which the push begins."""
        return round(self.at * (move.steps - self.steps))

    def displace(self, actions: np.ndarray) -> np.ndarray:
        """What the hand is led along instead of the commanded actions (`steps`, 10) float32."""
        led = actions.astype(np.float64)
        for k in range(len(led)):
            share = (k + 1) / len(led)
            turn = Rotation.from_rotvec(share * np.array(self.rotation_rad)).as_matrix()
            led[k, :3] += share * np.array(self.offset_m)
            led[k, 3:9] = matrix_to_rot6d(turn @ rot6d_to_matrix(led[k, 3:9]))
        return led.astype(np.float32)


class Recovery(Document):
    """`recovery.json` (`schema: codediffuser.recovery/1`): the push of an episode."""

    KIND: ClassVar[str] = "recovery"
    VERSION: ClassVar[int] = 1

    probability: float
    """Share of the demonstrations that are pushed, as it was asked for."""
    seed: SeedKey
    """Address of the generator that drew the push."""
    push: Push
    first_step: int
    """Control step of the episode at which the push began."""

    def executed(self, actions: np.ndarray) -> np.ndarray:
        """What the simulation was given, from the recorded actions (T, 10) float32."""
        executed = actions.copy()
        pushed = slice(self.first_step, self.first_step + self.push.steps)
        executed[pushed] = self.push.displace(actions[pushed])
        return executed


def draw_push(task: Task, seed: SeedKey, probability: float) -> Push | None:
    """Draw whether a scene's demonstration is pushed, and how.

    Raises:
        ConfigError: `probability` is not within 0 and 1.
    """
    if not 0 <= probability <= 1:
        raise ConfigError(f"recovery: expected a probability from 0 to 1, got {probability}")
    rng = rng_for(seed.root, Stage.RECOVERY, seed.index)
    if rng.uniform() >= probability:
        return None
    direction = rng.standard_normal(3)
    # Down is where things are.
    direction[2] = abs(direction[2])
    offset = rng.uniform(*OFFSET_M) * direction / np.linalg.norm(direction)
    x, y, z = (float(v) for v in offset)
    roll, pitch, yaw = (float(v) for v in rng.uniform(-TURN_RAD, TURN_RAD, size=3))
    return Push(
        phase=task.push_phases[rng.integers(len(task.push_phases))],
        at=float(rng.uniform()),
        steps=int(rng.integers(STEPS[0], STEPS[1] + 1)),
        offset_m=(x, y, z),
        rotation_rad=(roll, pitch, yaw),
        recover_steps=RECOVER_STEPS,
    )


def recovery_record(seed: SeedKey, probability: float, push: Push, first_step: int) -> Recovery:
    """The document of a push that took place."""
    address = SeedKey(root=seed.root, stage=Stage.RECOVERY.name, index=seed.index, attempt=0)
    return Recovery(probability=probability, seed=address, push=push, first_step=first_step)
