"""Runs a task's scripted moves in the simulator and records what came of them.

Physics only: nothing is drawn, nothing is placed by hand. A pose that cannot be reached ends the
demonstration as a recorded failure.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.motion import (
    Command,
    command_of,
    end_command,
    held_command,
    interpolate,
)
from codediffuser.datagen.recovery import RECOVER
from codediffuser.datagen.task import Check, Move
from codediffuser.datagen.views import join_moments
from codediffuser.errors import PlanningError

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.recovery import Push
    from codediffuser.datagen.scene import SceneSpec
    from codediffuser.datagen.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class ExpertRun:
    """One scripted demonstration, successful or not."""

    scene: SceneSpec
    trajectory: Trajectory
    phases: tuple[str, ...]
    """Phase of each action, (T,)."""
    check: Check
    """Conditions of success in the last state."""
    failure_reason: str
    """Conditions that do not hold, or why planning stopped; empty after success."""
    failure_phase: str
    """Phase in which it went wrong; empty after success."""
    pushed_at: int | None = None
    """Control step at which a push began; None when there was none."""

    @property
    def success(self) -> bool:
        """Whether the script ran to its end and all conditions hold."""
        return not self.failure_reason


@dataclass(frozen=True, slots=True)
class ControlStep:
    """One control step of a demonstration that was carried out."""

    phase: str
    action: np.ndarray
    """(10,) float32: what the expert commanded, and what is recorded."""
    pushed: bool = False
    """Whether the hand was led elsewhere than commanded, by a push."""


def run_expert(
    env: SceneEnv, scene: SceneSpec, rng: np.random.Generator, push: Push | None = None
) -> ExpertRun:
    """Reset the environment to a scene and carry out the task's script.

    Args:
        env: The task's environment; `render_backend="none"` suffices.
        scene: What to reset to.
        rng: Variation of the script. The same scene and generator state give the same bits.
        push: What pushes the hand off its path once, and is then made good; None for nothing.

    Returns:
        The run up to its end, or up to the step at which a pose could not be reached.
    """
    env.reset(options={"scene": scene})
    moments, steps = [env.view.moment()], []
    reason = phase = ""
    try:
        for step in expert_steps(env, rng, push):
            moments.append(env.view.moment())
            steps.append(step)
    except PlanningError as error:
        reason, phase = str(error), f"{steps[-1].phase if steps else 'start'}:unreachable"
    trajectory = join_moments(env.view.object_ids, moments, [s.action for s in steps])
    check = env.check()
    if not reason and not check.success:
        reason = check.reason
        phase = env.task.failure_phase(scene, trajectory, scene.instruction.pairs)
    pushed_at = next((k for k, s in enumerate(steps) if s.pushed), None)
    phases = tuple(s.phase for s in steps)
    return ExpertRun(scene, trajectory, phases, check, reason, phase, pushed_at)


def expert_steps(
    env: SceneEnv, rng: np.random.Generator, push: Push | None = None
) -> Iterator[ControlStep]:
    """Carry out the script of the scene that `env` is reset to, step by step.

    Yields:
        Each control step after it was carried out.

    Raises:
        PlanningError: A commanded pose cannot be reached.
    """
    command = held_command(env.view.moment())
    for move in env.task.script(env.view, rng):
        if push is not None and push.fits(move):
            yield from _pushed_move(env, command, move, push)
            push = None
        else:
            yield from _carry_out(env, move.phase, interpolate(command, move))
        command = end_command(move)


def _pushed_move(env: SceneEnv, command: Command, move: Move, push: Push) -> Iterator[ControlStep]:
    """Set out on a move, be pushed off it, and go on to its end from there."""
    planned = interpolate(command, move)
    start = push.start(move)
    stop = start + push.steps
    yield from _carry_out(env, move.phase, planned[:start])
    executed = push.displace(planned[start:stop])
    for action, pushed in zip(planned[start:stop], executed, strict=True):
        _control(env, move.phase, pushed)
        yield ControlStep(move.phase, action, pushed=True)
    back = replace(move, steps=max(move.steps - stop, push.recover_steps))
    yield from _carry_out(env, RECOVER, interpolate(command_of(executed[-1]), back))


def _carry_out(env: SceneEnv, phase: str, actions: np.ndarray) -> Iterator[ControlStep]:
    for action in actions:
        _control(env, phase, action)
        yield ControlStep(phase, action)


def _control(env: SceneEnv, phase: str, action: np.ndarray) -> None:
    failures = env.ik_failures
    env.control_step(action)
    if env.ik_failures > failures:
        scene = env.scene_spec
        raise PlanningError(
            f"{scene.task} scene {scene.scene_id}, phase '{phase}', step "
            f"{int(env.elapsed_steps[0])}: no joint angles reach the hand pose at "
            f"{np.round(action[:3], 3).tolist()} m; keep the script within the arm's reach"
        )
