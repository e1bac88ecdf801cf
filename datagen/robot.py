"""The Panda arm as all tasks use it: light meshes, absolute hand-pose control."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import sapien
from mani_skill.agents.base_agent import BaseAgent, Keyframe
from mani_skill.agents.registration import register_agent

from codediffuser.datagen.assets import panda_urdf
from codediffuser.datagen.controllers import Drive, HandPoseControllerConfig
from codediffuser.datagen.task_config import RobotConfig
from codediffuser.poses import matrix_to_quat_wxyz, rotation_z

ROBOT_UID = "panda_codediffuser"
CONTROL_MODE = "abs_hand_pose"
HAND_LINK = "panda_hand"

ARM_DRIVE = Drive(stiffness=1800, damping=180, force_limit=100)
FINGER_DRIVE = Drive(stiffness=1200, damping=60, force_limit=360)


@register_agent()
class PandaHandPose(BaseAgent):
    """Franka Panda with its gripper, commanded by the pose of `panda_hand` in the world."""

    uid = ROBOT_UID
    urdf_config: ClassVar[dict[str, Any]] = {
        "_materials": {
            "finger": {"static_friction": 1.5, "dynamic_friction": 1.0, "restitution": 0.01}
        },
        "link": {
            f"panda_{side}finger": {
                "material": "finger",
                "patch_radius": 0.04,
                "min_patch_radius": 0.02,
            }
            for side in ("left", "right")
        },
    }
    keyframes: ClassVar[dict[str, Keyframe]] = {
        "rest": Keyframe(
            pose=sapien.Pose(),
            qpos=np.array(
                [0, np.pi / 8, 0, -np.pi * 5 / 8, 0, np.pi * 3 / 4, np.pi / 4, 0.04, 0.04]
            ),
        )
    }
    joint_names: ClassVar[list[str]] = [
        *(f"panda_joint{i}" for i in range(1, 8)),
        *(f"panda_finger_joint{i}" for i in (1, 2)),
    ]

    @property
    def urdf_path(self) -> str:
        """The light robot's URDF; the first use on a machine builds it."""
        return str(panda_urdf())

    @property
    def _controller_configs(self) -> dict[str, HandPoseControllerConfig]:
        return {
            CONTROL_MODE: HandPoseControllerConfig(
                joint_names=self.joint_names,
                link_name=HAND_LINK,
                arm=ARM_DRIVE,
                finger=FINGER_DRIVE,
            )
        }


def base_pose(config: RobotConfig) -> sapien.Pose:
    """Pose of the robot's base in the world."""
    return sapien.Pose(
        np.array(config.base_position_m), matrix_to_quat_wxyz(rotation_z(config.base_yaw_rad))
    )
