"""Single moments of a trajectory, and what scripts and checks see of them. No simulator needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.poses import matrix_to_rot6d, pose_to_transform, quat_wxyz_to_matrix


@dataclass(frozen=True, slots=True)
class Moment:
    """The state of a scene at one moment: one row of a `Trajectory`, fields of the same names."""

    object_position_m: np.ndarray
    """(n_objects, 3) float64, world."""
    object_quat_wxyz: np.ndarray
    """(n_objects, 4) float64."""
    object_velocity: np.ndarray
    """(n_objects, 6) float64: linear m/s, then angular rad/s, world."""
    qpos: np.ndarray
    """(9,) float64: seven arm joints in rad, two fingers in m."""
    qvel: np.ndarray
    """(9,) float64."""
    hand_position_m: np.ndarray
    """(3,) float64, world."""
    hand_quat_wxyz: np.ndarray
    """(4,) float64."""


def state_row(moment: Moment) -> np.ndarray:
    """Measured hand pose and mean finger opening, (10,) float32, laid out like the action."""
    rot6d = matrix_to_rot6d(quat_wxyz_to_matrix(moment.hand_quat_wxyz))
    opening = np.mean(moment.qpos[-2:])
    return np.concatenate([moment.hand_position_m, rot6d, [opening]]).astype(np.float32)


def moment_at(trajectory: Trajectory, moment: int) -> Moment:
    """One row of a trajectory; negative counts from the end."""
    return Moment(*(getattr(trajectory, f.name)[moment] for f in fields(Moment)))


def join_moments(
    object_ids: Sequence[str], moments: Sequence[Moment], actions: Sequence[np.ndarray]
) -> Trajectory:
    """Build a trajectory from T + 1 moments and the T actions (10,) between them."""
    rows = {f.name: np.stack([getattr(m, f.name) for m in moments]) for f in fields(Moment)}
    joined = np.array(actions, dtype=np.float32).reshape(len(actions), 10)
    return Trajectory(object_ids=tuple(object_ids), actions=joined, **rows)


class MomentView:
    """`SceneView` of a stored moment.

    Args:
        scene: The configuration that was reset to.
        object_ids: Ids of the rows of the moment's object arrays.
        moment: The state to look at.
    """

    def __init__(self, scene: SceneSpec, object_ids: Sequence[str], moment: Moment) -> None:
        self._scene = scene
        self._row = {object_id: i for i, object_id in enumerate(object_ids)}
        self._moment = moment

    @property
    def scene(self) -> SceneSpec:
        """The configuration that was reset to."""
        return self._scene

    def T_world_object(self, object_id: str) -> np.ndarray:
        """Pose (4, 4) float64 of a movable object."""
        i, m = self._row[object_id], self._moment
        return pose_to_transform(m.object_position_m[i], m.object_quat_wxyz[i])

    def object_speed(self, object_id: str) -> tuple[float, float]:
        """Linear m/s and angular rad/s of a movable object."""
        velocity = self._moment.object_velocity[self._row[object_id]]
        return float(np.linalg.norm(velocity[:3])), float(np.linalg.norm(velocity[3:]))

    def T_world_hand(self) -> np.ndarray:
        """Pose (4, 4) float64 of `panda_hand`."""
        return pose_to_transform(self._moment.hand_position_m, self._moment.hand_quat_wxyz)

    def gripper_opening_m(self) -> float:
        """Mean opening of the two fingers, 0 to 0.04 m each."""
        return float(np.mean(self._moment.qpos[-2:]))


class TrajectoryView(MomentView):
    """`SceneView` of one moment of a trajectory; the last one unless told otherwise."""

    def __init__(self, scene: SceneSpec, trajectory: Trajectory, moment: int = -1) -> None:
        super().__init__(scene, trajectory.object_ids, moment_at(trajectory, moment))
