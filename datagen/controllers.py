"""Absolute hand-pose control: where the hand shall be in the world, and how wide the fingers.

An action is `ACTION_NAMES`: position, rotation-6D of `panda_hand`, opening of each finger. Inverse
kinematics turns it into joint drive targets once per control step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sapien
import torch
from gymnasium import spaces
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig

from codediffuser.errors import ShapeError
from codediffuser.poses import matrix_to_quat_wxyz, rot6d_to_matrix

NUM_ARM_JOINTS = 7
MAX_OPENING_M = 0.04
REACH_M = 2.0
"""Bound of the action space for each coordinate; the arm reaches less than a metre."""


def action_space() -> spaces.Box:
    """Box (10,) float32 of all actions. Values beyond it are not clipped, save the gripper's."""
    low = np.array([-REACH_M] * 3 + [-1.0] * 6 + [0.0], dtype=np.float32)
    high = np.array([REACH_M] * 3 + [1.0] * 6 + [MAX_OPENING_M], dtype=np.float32)
    return spaces.Box(low, high, dtype=np.float32)


class HandIK:
    """Closed-loop inverse kinematics of one link, by the simulator's own pinocchio.

    The library's default step and damping fail on ordinary moves of this arm; these values had no
    failure in 50 000 control steps of the prototype.

    Args:
        articulation: The arm with its fingers; fingers are kept still.
        link: The link of it whose pose is asked for.
    """

    EPS = 3e-4
    DT = 0.5
    DAMP = 1e-3
    MAX_ITERATIONS = 100

    def __init__(
        self,
        articulation: sapien.physx.PhysxArticulation,
        link: sapien.physx.PhysxArticulationLinkComponent,
    ) -> None:
        self._model = articulation.create_pinocchio_model()
        self._link = link.index
        self._limits_rad = np.asarray(articulation.get_qlimits(), dtype=np.float64)
        self._active = np.zeros(articulation.dof, dtype=np.int32)
        self._active[:NUM_ARM_JOINTS] = 1

    def solve(self, pose_base: sapien.Pose, seed_rad: np.ndarray) -> np.ndarray | None:
        """Joint angles (7,) rad that bring the link to a pose in the robot's base frame.

        Args:
            pose_base: Wanted pose.
            seed_rad: (7,) where to start; the solution is one near it.

        Returns:
            The angles, or None when the pose is out of reach or beyond the joint limits.
        """
        seed = np.zeros(len(self._active))
        seed[:NUM_ARM_JOINTS] = seed_rad
        qpos, success, _ = self._model.compute_inverse_kinematics(
            self._link,
            pose_base,
            initial_qpos=seed,
            active_qmask=self._active,
            eps=self.EPS,
            max_iterations=self.MAX_ITERATIONS,
            dt=self.DT,
            damp=self.DAMP,
        )
        angles = np.asarray(qpos, dtype=np.float64).reshape(-1)[:NUM_ARM_JOINTS]
        low, high = self._limits_rad[:NUM_ARM_JOINTS].T
        if not success or np.any(angles < low) or np.any(angles > high):
            return None
        return angles


class HandPoseController(BaseController):
    """ManiSkill controller for `ACTION_NAMES`, on the CPU backend with one environment.

    `command` is the same control in plain NumPy, for loops that skip ManiSkill's tensors.
    """

    config: HandPoseControllerConfig
    sets_target_qpos = True
    sets_target_qvel = False

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._robot = self.articulation._objs[0]
        self._drives = [joint._objs[0] for joint in self.joints]
        hand = self.articulation.links_map[self.config.link_name]._objs[0]
        self._ik = HandIK(self._robot, hand)
        self._T_base_world = sapien.Pose()
        self._target = np.zeros(len(self._drives))
        self.ik_failures = 0

    def _initialize_action_space(self) -> None:
        self.single_action_space = action_space()

    def set_drive_property(self) -> None:
        """Give every joint its stiffness, damping and force limit."""
        for i, joint in enumerate(self.joints):
            drive = self.config.arm if i < NUM_ARM_JOINTS else self.config.finger
            joint.set_drive_properties(
                drive.stiffness, drive.damping, force_limit=drive.force_limit, mode="force"
            )

    def reset(self) -> None:
        """Hold the present joint positions, and forget counted failures."""
        self._T_base_world = self._robot.pose.inv()
        self._set_targets(np.asarray(self._robot.qpos, dtype=np.float64))
        self.ik_failures = 0

    def command(self, action: np.ndarray) -> None:
        """Set the drive targets for one control step.

        A pose that cannot be reached leaves the arm's targets as they were and is counted in
        `ik_failures`; the fingers follow in any case.

        Args:
            action: (10,) float, see `ACTION_NAMES`.
        """
        target = self._target.copy()
        target[NUM_ARM_JOINTS:] = np.clip(action[9], 0.0, MAX_OPENING_M)
        angles = self._solve(np.asarray(action, dtype=np.float64))
        if angles is None:
            self.ik_failures += 1
        else:
            target[:NUM_ARM_JOINTS] = angles
        self._set_targets(target)

    def _solve(self, action: np.ndarray) -> np.ndarray | None:
        try:
            R_world_hand = rot6d_to_matrix(action[3:9])
        except ShapeError:
            return None
        T_world_hand = sapien.Pose(action[:3], matrix_to_quat_wxyz(R_world_hand))
        return self._ik.solve(self._T_base_world * T_world_hand, self._target[:NUM_ARM_JOINTS])

    def _set_targets(self, target: np.ndarray) -> None:
        # PhysX keeps float32; seeding the next solution with the same number makes a restored
        # state go on exactly like the original.
        self._target = target.astype(np.float32).astype(np.float64)
        for drive, value in zip(self._drives, self._target, strict=True):
            drive.set_drive_target(value)

    def set_action(self, action: torch.Tensor) -> None:
        """Set the drive targets from ManiSkill's batch (1, 10)."""
        self.command(self._preprocess_action(action)[0].numpy())

    def get_state(self) -> dict[str, torch.Tensor]:
        """Drive targets (1, 9), rad and m."""
        return {"target_qpos": torch.from_numpy(self._target.astype(np.float32))[None]}

    def set_state(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what `get_state` gave."""
        self._set_targets(state["target_qpos"][0].numpy().astype(np.float64))


@dataclass(frozen=True, slots=True)
class Drive:
    """Gains of one joint's drive."""

    stiffness: float
    damping: float
    force_limit: float


@dataclass
class HandPoseControllerConfig(ControllerConfig):
    """Which link is controlled, and how stiffly.

    `joint_names` lists the seven arm joints and then the two fingers.
    """

    link_name: str
    arm: Drive
    finger: Drive
    controller_cls = HandPoseController
