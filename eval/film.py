"""Pictures of a finished rollout, drawn from its recorded states.

Physics first, pictures second: nothing here can change an outcome, and a film can be made again
with other cameras.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.datagen.task_config import CameraConfig, CameraView
from codediffuser.datagen.trajectory import CONTROL_HZ, Trajectory
from codediffuser.datagen.views import moment_at
from codediffuser.eval.observe import object_poses
from codediffuser.eval.video import TILE_SIZE, Caption, VideoView, compose_frame, tint_attention
from codediffuser.labeling.attention import AttentionField

if TYPE_CHECKING:
    from codediffuser.datagen.rendering import Renderer

STRIDE = 4
"""Control steps between pictures."""

FPS = CONTROL_HZ / STRIDE
DIRECTIONS = {"front": (0.5, 0.75, 0.55), "side": (-0.9, 0.1, 0.35)}
"""Where the cameras stand, seen from what they look at."""

DISTANCE_SHARE = 1.6
"""Distance of the cameras per diagonal of the workspace on the table."""

AIM_SHARE = 0.22
"""Height that the cameras look at, as a share of the workspace's."""

FOV_Y_RAD = 0.55
LIFTED_M = 0.03
OPEN_M = 0.03


def film_cameras(task: Task) -> CameraConfig:
    """Two cameras for people: one faces the arm, one looks low from its left.

    They are placed around the workspace, so that they suit any task, and are no policy's input.
    """
    box = task.config.workspace
    low, high = np.array(box.low_m), np.array(box.high_m)
    aim = (low + high) / 2
    aim[2] = low[2] + AIM_SHARE * (high[2] - low[2])
    reach = float(np.linalg.norm((high - low)[:2]))
    views = []
    for name, direction in DIRECTIONS.items():
        away = np.array(direction) / np.linalg.norm(direction)
        right = np.cross(-away, [0.0, 0.0, 1.0])
        x, y, z = (float(v) for v in aim + DISTANCE_SHARE * reach * away)
        views.append(
            CameraView(
                name=name, position_m=(x, y, z),
                look=(float(-away[0]), float(-away[1]), float(-away[2])),
                right=(float(right[0]), float(right[1]), 0.0),
            )
        )  # fmt: skip
    width, height = TILE_SIZE
    return CameraConfig(width=width, height=height, fov_y_rad=FOV_Y_RAD, views=tuple(views))


def film(
    renderer: Renderer,
    scene: SceneSpec,
    trajectory: Trajectory,
    field: AttentionField,
    *,
    instruction: str,
    attended: tuple[str, ...],
    holds: Sequence[bool],
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Draw every `STRIDE`-th moment and the last one.

    Args:
        renderer: With the cameras of `film_cameras`; it takes the scene.
        scene: What was reset to.
        trajectory: What happened.
        field: Attention, tinted into the pictures; may have no labels.
        instruction: Written beneath.
        attended: Names of the attended things, written beneath.
        holds: (T + 1,) whether success held at each moment.

    Yields:
        The composed frame, and the first camera's picture alone.
    """
    renderer.set_scene(scene)
    phases = motion_phases(trajectory)
    for index in [*range(0, trajectory.num_steps, STRIDE), trajectory.num_steps]:
        moment = moment_at(trajectory, index)
        frames = renderer.render(moment)
        points, attention = field.carried(object_poses(scene, trajectory.object_ids, moment))
        pictures = [
            tint_attention(
                VideoView(frames[name].rgb, frames[name].depth_m, K, T), points, attention
            )
            for name, (K, T) in renderer.parameters.items()
        ]
        caption = Caption(
            instruction, index / CONTROL_HZ, phases[index], attended, bool(holds[index])
        )
        yield compose_frame(pictures, caption), pictures[0]


def motion_phases(trajectory: Trajectory) -> list[str]:
    """Name what the arm is about at each of T + 1 moments, for any pick-and-place task.

    `reach` until the fingers close, `grasp` until something rises, `carry` while it is held, and
    `released` after the fingers open again.
    """
    opening = trajectory.qpos[:, -2:].mean(axis=1)
    rise = trajectory.object_position_m[:, :, 2] - trajectory.object_position_m[0, :, 2]
    lifted = (rise > LIFTED_M).any(axis=1)
    phases, phase = [], "reach"
    for is_open, is_lifted in zip(opening > OPEN_M, lifted, strict=True):
        if phase == "carry":
            phase = "released" if is_open else "carry"
        elif phase != "released":
            phase = "carry" if is_lifted and not is_open else "reach" if is_open else "grasp"
        phases.append(phase)
    return phases
