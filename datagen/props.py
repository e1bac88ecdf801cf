"""Props: things that only look, put where nothing of an episode ever comes.

They have no body, so they cannot change what the recorded physics did; the clearance makes the
pictures true all the same.
"""

from __future__ import annotations

import numpy as np
import trimesh
from pydantic import Field

from codediffuser.datagen.appearance import Prop
from codediffuser.datagen.ranges import CountRange, Range
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.poses import apply_transform, matrix_to_quat_wxyz, rotation_z
from codediffuser.schema import Strict

HAND_REACH_M = 0.12
"""Half the width of the open hand, and some air."""

MOMENT_STRIDE = 4
"""Recorded moments between looks at where things are: 0.16 s."""

SHAPES = ("box", "cylinder", "sphere")


class PropRanges(Strict):
    """How many props lie where."""

    count: CountRange
    size_m: Range
    """Of each extent."""
    area_x_m: Range
    area_y_m: Range
    clearance_m: float = Field(ge=0)
    """To everything of the scene at every moment, and to each other."""
    max_tries: int = Field(default=30, ge=1)
    """Places that are tried for one prop; one that finds none is left out."""


def draw_props(
    rng: np.random.Generator,
    ranges: PropRanges | None,
    task: Task,
    scene: SceneSpec,
    trajectory: Trajectory,
) -> tuple[Prop, ...]:
    """Draw props on the table, clear of each other and of all that stands or moves there."""
    if ranges is None:
        return ()
    taken = occupied_rectangles(task, scene, trajectory)
    props = []
    for _ in range(int(rng.integers(ranges.count[0], ranges.count[1] + 1))):
        shape = SHAPES[rng.integers(len(SHAPES))]
        size = rng.uniform(*ranges.size_m, size=3)
        if shape != "box":
            size[1] = size[0]
        if shape == "sphere":
            size[2] = size[0]
        radius = float(np.hypot(size[0], size[1])) / 2
        spot = _free_spot(rng, ranges, radius, taken)
        yaw, color = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.85, size=3)
        if spot is None:
            continue
        taken = np.vstack([taken, np.concatenate([spot - radius, spot + radius])])
        props.append(
            Prop(
                shape=shape,  # type: ignore[arg-type]
                size_m=tuple(size.tolist()),
                position_m=(float(spot[0]), float(spot[1]), float(size[2]) / 2),
                quat_wxyz=tuple(matrix_to_quat_wxyz(rotation_z(yaw)).tolist()),
                color_rgb=tuple(color.tolist()),
            )
        )
    return tuple(props)


def _free_spot(
    rng: np.random.Generator, ranges: PropRanges, radius: float, taken: np.ndarray
) -> np.ndarray | None:
    """Middle (2,) of a disc that keeps the clearance, or None after all tries."""
    for _ in range(ranges.max_tries):
        spot = np.array([rng.uniform(*ranges.area_x_m), rng.uniform(*ranges.area_y_m)])
        outside = np.maximum(taken[:, :2] - spot, spot - taken[:, 2:]).clip(min=0)
        if np.all(np.linalg.norm(outside, axis=1) >= radius + ranges.clearance_m):
            return spot
    return None


def occupied_rectangles(task: Task, scene: SceneSpec, trajectory: Trajectory) -> np.ndarray:
    """What stands or moves over the table, (N, 4) float64: low x, low y, high x, high y, metres.

    Every object and the hand, at moments close enough together.
    """
    moments = range(0, trajectory.num_steps + 1, MOMENT_STRIDE)
    rectangles = []
    for obj in scene.objects:
        corners = trimesh.bounds.corners(task.geometry(obj).visual.bounds)
        rectangles += [_rectangle(obj.T_world_object, corners)]
        if not obj.fixed:
            poses = [trajectory.T_world_object(obj.id, k) for k in moments]
            rectangles += [_rectangle(T, corners) for T in poses]
    hand = trajectory.hand_position_m[::MOMENT_STRIDE, :2]
    rectangles += [np.concatenate([xy - HAND_REACH_M, xy + HAND_REACH_M]) for xy in hand]
    return np.array(rectangles)


def _rectangle(T_world_object: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Bounds of a turned box, seen from above, (4,)."""
    xy = apply_transform(T_world_object, corners)[:, :2]
    return np.concatenate([xy.min(axis=0), xy.max(axis=0)])


def prop_mesh(prop: Prop) -> trimesh.Trimesh:
    """Surface of a prop around its middle."""
    if prop.shape == "box":
        return trimesh.creation.box(prop.size_m)
    if prop.shape == "cylinder":
        return trimesh.creation.cylinder(prop.size_m[0] / 2, prop.size_m[2], sections=24)
    return trimesh.creation.icosphere(subdivisions=2, radius=prop.size_m[0] / 2)
