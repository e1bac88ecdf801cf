"""Closed-loop evaluation of a policy of your own, from the sentence to the last state.

This one learns nothing: it looks once at the attended points and moves the hand from the middle of
the object to the middle of the place. Whatever has the methods of `PolicyHandle` can stand here.

    python examples/06_evaluate_your_own_policy.py --scenes 5
"""

from __future__ import annotations

import numpy as np
import tyro

from codediffuser.datagen.motion import command_of, end_command, interpolate
from codediffuser.datagen.packing_script import R_WORLD_HAND_DOWN
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import Move, get_task
from codediffuser.eval.attention_source import LanguageSource
from codediffuser.eval.rollout import ClosedLoop, RolloutOptions
from codediffuser.poses import make_transform
from codediffuser.seeding import Stage

PICK, PLACE = 3, 4
"""Columns of the cloud that hold attention."""


class MiddleToMiddle:
    """Takes the attended object by its middle to the middle of the attended place."""

    def reset(self, seed: int) -> None:
        """Forget the scene before; nothing here is random."""
        self._actions: list[np.ndarray] = []

    @property
    def needs_observation(self) -> bool:
        """Only the first control step is looked at."""
        return not self._actions

    def act(self, points: np.ndarray | None, state: np.ndarray | None) -> np.ndarray:
        """Next action (10,); the last one is held."""
        if points is not None and state is not None:
            self._actions = list(self._plan(points, state))
        return self._actions.pop(0) if len(self._actions) > 1 else self._actions[0]

    def _plan(self, points: np.ndarray, state: np.ndarray) -> np.ndarray:
        middle = {role: points[points[:, role] > 0, :2] for role in (PICK, PLACE)}
        # Half of the extent, not the mean: cameras see one side of a thing more than the other.
        start, goal = (0.5 * (xy.min(axis=0) + xy.max(axis=0)) for xy in middle.values())
        heights = [(start, 0.27, 25, 0.04), (start, 0.13, 20, 0.04), (start, 0.13, 15, 0.0),
                   (start, 0.27, 20, 0.0), (goal, 0.27, 35, 0.0), (goal, 0.205, 30, 0.0),
                   (goal, 0.205, 10, 0.04), (goal, 0.27, 20, 0.04)]  # fmt: skip
        command, rows = command_of(state), []
        for xy, z, steps, gripper_m in heights:
            T_world_hand = make_transform(R_WORLD_HAND_DOWN, np.array([*xy, z]))
            move = Move("move", T_world_hand, steps, gripper_m)
            rows.append(interpolate(command, move))
            command = end_command(move)
        return np.concatenate(rows)


def main(scenes: int = 5, seed: int = 0) -> None:
    """Run rollouts in unseen scenes and print how each ended."""
    task = get_task("pack_battery")
    loop = ClosedLoop(task, MiddleToMiddle(), LanguageSource(), RolloutOptions(max_steps=240))
    successes = 0
    for index in range(scenes):
        scene = sample_scene(task, root_seed=seed, index=index, stage=Stage.EVAL_SCENE)
        result = loop.run(scene).result
        successes += result.success
        print(f"{scene.instruction.text}  ->  {result.failure or 'success'}")
    print(f"{successes} of {scenes}")


if __name__ == "__main__":
    tyro.cli(main)
