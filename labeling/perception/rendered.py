"""Scenes as cameras see them before anything moves: what perception learns from and is judged by.

A scene is reset in the simulator, settles, and is drawn once. Which object a pixel shows comes
along for training and for judging; nothing that finds instances may look at it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from codediffuser.datagen.appearance import Looks
from codediffuser.datagen.episode_format import Camera
from codediffuser.datagen.randomization import Randomization, draw_appearance
from codediffuser.datagen.scene import ObjectSpec, PlaceSpec, SceneSpec
from codediffuser.datagen.sensor_errors import sensor_rng, spoil_color, spoil_depth
from codediffuser.datagen.task import Task
from codediffuser.datagen.views import Moment, MomentView, join_moments
from codediffuser.labeling.perception.views import View
from codediffuser.poses import (
    apply_transform,
    matrix_to_quat_wxyz,
    quat_wxyz_to_matrix,
    rotation_z,
)

FILLED = 0.9
"""A place is seen as its object when the object's bounds take up more than this of its region."""


@dataclass(frozen=True, slots=True)
class StartScene:
    """One settled scene and its pictures."""

    scene: SceneSpec
    T_world_start: Mapping[str, np.ndarray]
    """Pose (4, 4) float64 of each movable object after settling."""
    views: tuple[View, ...]
    object_index: np.ndarray
    """(V, H, W) int16: row of `scene.objects`, or negative."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """How far training scenes leave what the sampler draws; probabilities per scene."""

    recolor: float = 0.3
    """Chance that objects take any colour."""
    lift: float = 0.3
    """Chance that one object hangs in the air, tilted, as if it were carried."""
    lift_m: float = 0.25
    tilt_rad: float = 0.6
    move_arm: float = 0.3
    """Chance that the arm stands elsewhere."""
    arm_rad: float = 0.35


class StartRenderer:
    """Settles and draws scenes of one task; the simulator and the cameras are built once.

    Args:
        task: Whose scenes are drawn.

    Raises:
        SetupError: There is no usable Vulkan device.
    """

    def __init__(self, task: Task) -> None:
        from codediffuser.datagen.envs import physics_env
        from codediffuser.datagen.rendering import Renderer

        self.task = task
        self._env = physics_env(task.name)
        self._renderer = Renderer(task)

    def draw(
        self,
        scene: SceneSpec,
        ranges: Randomization | None = None,
        disturbance: Disturbance | None = None,
        rng: np.random.Generator | None = None,
    ) -> StartScene:
        """Reset to a scene, let it settle and draw it.

        Args:
            scene: What stands where.
            ranges: Domain randomisation; None is the usual look with perfect sensors.
            disturbance: What else may differ; needs `rng`.
            rng: Draws the disturbance.

        Returns:
            The scene as it was drawn: with a disturbance, its colours may not be those given.
        """
        if disturbance is not None and rng is not None:
            scene = _recolored(scene, disturbance, rng)
        self._env.reset(options={"scene": scene})
        ids, moment = self._env.view.object_ids, self._env.view.moment()
        looks = Looks()
        if ranges is not None:
            still = join_moments(ids, [moment], [])
            looks = draw_appearance(ranges, "perception", self.task, scene, still).looks
        if disturbance is not None and rng is not None:
            moment = _disturbed(scene, ids, moment, disturbance, rng)
        self._renderer.set_scene(scene, looks)
        frames = self._renderer.render(moment)
        views = []
        for number, (name, frame) in enumerate(frames.items()):
            K, T_world_camera = self._renderer.parameters[name]
            rgb, depth_m = frame.rgb, frame.depth_m
            if looks.sensor is not None:
                noise = sensor_rng(scene.seed, 0, number)
                rgb = spoil_color(rgb, looks.sensor, noise)
                depth_m = spoil_depth(depth_m, looks.sensor, noise)
            camera = Camera(K, T_world_camera, rgb.shape[1], rgb.shape[0])
            views.append(View(name, rgb, depth_m, camera))
        state = MomentView(scene, ids, moment)
        return StartScene(
            scene,
            {name: state.T_world_object(name) for name in ids},
            tuple(views),
            np.stack([frame.object_index for frame in frames.values()]),
        )


def seen_places(task: Task, scene: SceneSpec) -> tuple[PlaceSpec, ...]:
    """Places that can be seen as such: free ones, and taken ones that their object leaves room in.

    The place of a book in a row is the book itself; a crate's cell is a cell with a battery in it.
    """
    taker = {o.place: o for o in scene.objects if o.place is not None}
    return tuple(p for p in scene.places if p.id not in taker or not _fills(task, taker[p.id], p))


def body_center(task: Task, obj: ObjectSpec) -> np.ndarray:
    """Middle (3,) float64 of an object's bounds in its own frame, metres."""
    corners = np.concatenate([part.vertices for part in task.geometry(obj).collision])
    return np.asarray((corners.min(axis=0) + corners.max(axis=0)) / 2, dtype=np.float64)


def _fills(task: Task, obj: ObjectSpec, place: PlaceSpec) -> bool:
    vertices = np.concatenate([part.vertices for part in task.geometry(obj).collision])
    corners = apply_transform(obj.T_world_object, vertices)
    volume = np.prod(corners.max(axis=0) - corners.min(axis=0))
    return bool(volume > FILLED * np.prod(place.size_m))


def _recolored(scene: SceneSpec, how: Disturbance, rng: np.random.Generator) -> SceneSpec:
    if rng.uniform() >= how.recolor:
        return scene
    objects = []
    for obj in scene.objects:
        r, g, b = rng.uniform(0.02, 0.9, 3).tolist()
        objects.append(obj.model_copy(update={"color_rgb": (r, g, b)}))
    return scene.model_copy(update={"objects": tuple(objects)})


def _disturbed(
    scene: SceneSpec,
    ids: tuple[str, ...],
    moment: Moment,
    how: Disturbance,
    rng: np.random.Generator,
) -> Moment:
    position, quat = moment.object_position_m.copy(), moment.object_quat_wxyz.copy()
    if rng.uniform() < how.lift:
        row = ids.index(scene.pickable[rng.integers(len(scene.pickable))].id)
        position[row, 2] += rng.uniform(0.02, how.lift_m)
        tilt = Rotation.from_euler("xy", rng.uniform(-how.tilt_rad, how.tilt_rad, 2)).as_matrix()
        turn = rotation_z(rng.uniform(-np.pi, np.pi))
        quat[row] = matrix_to_quat_wxyz(tilt @ turn @ quat_wxyz_to_matrix(quat[row]))
    qpos = moment.qpos.copy()
    if rng.uniform() < how.move_arm:
        qpos[:7] += rng.uniform(-how.arm_rad, how.arm_rad, 7)
    return replace(moment, object_position_m=position, object_quat_wxyz=quat, qpos=qpos)
