"""Runs a task's scripted moves in the simulator and records what came of them.

Physics only: nothing is drawn, nothing is placed by hand. A pose that cannot be reached ends the
demonstration as a recorded failure.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.task import Check, Move
from codediffuser.datagen.views import join_moments
from codediffuser.errors import PlanningError
from codediffuser.poses import matrix_to_quat_wxyz, matrix_to_rot6d, quat_wxyz_to_matrix

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.scene import SceneSpec
    from codediffuser.datagen.trajectory import Trajectory
    from codediffuser.datagen.views import Moment


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

    @property
    def success(self) -> bool:
        """Whether the script ran to its end and all conditions hold."""
        return not self.failure_reason


@dataclass(frozen=True, slots=True)
class Command:
    """What the hand was last told: the start of the next move."""

    position_m: np.ndarray
    """(3,) float64, world."""
    quat_wxyz: np.ndarray
    """(4,) float64."""
    gripper_m: float


def run_expert(env: SceneEnv, scene: SceneSpec, rng: np.random.Generator) -> ExpertRun:
    """Reset the environment to a scene and carry out the task's script.

    Args:
        env: The task's environment; `render_backend="none"` suffices.
        scene: What to reset to.
        rng: Variation of the script. The same scene and generator state give the same bits.

    Returns:
        The run up to its end, or up to the step at which a pose could not be reached.
    """
    env.reset(options={"scene": scene})
    moments, actions, phases = [env.view.moment()], [], []
    reason = phase = ""
    try:
        for name, action in expert_actions(env, rng):
            moments.append(env.view.moment())
            actions.append(action)
            phases.append(name)
    except PlanningError as error:
        reason, phase = str(error), f"{phases[-1] if phases else 'start'}:unreachable"
    trajectory = join_moments(env.view.object_ids, moments, actions)
    check = env.check()
    if not reason and not check.success:
        reason = check.reason
        phase = env.task.failure_phase(scene, trajectory, scene.instruction.pairs)
    return ExpertRun(scene, trajectory, tuple(phases), check, reason, phase)


def expert_actions(env: SceneEnv, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray]]:
    """Carry out the script of the scene that `env` is reset to, step by step.

    Yields:
        Phase and action (10,) float32 of each control step, after it was carried out.

    Raises:
        PlanningError: A commanded pose cannot be reached.
    """
    command = held_command(env.view.moment())
    scene = env.scene_spec
    for move in env.task.script(env.view, rng):
        for action in interpolate(command, move):
            failures = env.ik_failures
            env.control_step(action)
            yield move.phase, action
            if env.ik_failures > failures:
                raise PlanningError(
                    f"{scene.task} scene {scene.scene_id}, phase '{move.phase}', step "
                    f"{int(env.elapsed_steps[0])}: no joint angles reach the hand pose at "
                    f"{np.round(action[:3], 3).tolist()} m; keep the script within the arm's reach"
                )
        command = end_command(move)


def held_command(moment: Moment) -> Command:
    """Command that keeps the hand where it is."""
    return Command(moment.hand_position_m, moment.hand_quat_wxyz, float(moment.qpos[-2:].mean()))


def end_command(move: Move) -> Command:
    """Command at the end of a move."""
    T = move.T_world_hand
    return Command(T[:3, 3], matrix_to_quat_wxyz(T[:3, :3]), move.gripper_m)


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
