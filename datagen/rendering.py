"""Draws recorded states: all cameras of a task, no physics steps, no tensors.

One `Renderer` serves a whole process: robot, table and cameras are built once, objects, lights and
whatever else an episode's appearance changes are exchanged per scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sapien

from codediffuser.datagen import sim
from codediffuser.datagen.appearance import Looks
from codediffuser.datagen.assets import panda_urdf
from codediffuser.datagen.cameras import camera_parameters, sapien_camera_pose
from codediffuser.datagen.episode_format import METRES_PER_MM
from codediffuser.datagen.known_shapes import Shapes
from codediffuser.datagen.robot import base_pose
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.datagen.task_config import CameraConfig
from codediffuser.datagen.views import Moment
from codediffuser.errors import RenderError, SetupError
from codediffuser.pointcloud import backproject_depth, inside_box

NOTHING_ID = -1
"""Object number of pixels that show neither an object of the scene nor the robot."""

ROBOT_ID = -2
"""Object number of pixels that show the robot."""

SHADERS = Path(__file__).parent / "shaders"
"""Draw what is recorded and nothing else; `gbuffer.frag` says what SAPIEN's own draw besides."""

SEEN = "Seen"
"""The one picture of these shaders."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What one camera saw."""

    rgb: np.ndarray
    """(H, W, 3) uint8."""
    depth_m: np.ndarray
    """(H, W) float32 along the optical axis, in steps of 1 mm; 0 where nothing was hit."""
    object_index: np.ndarray
    """(H, W) int16: row of `SceneSpec.objects`, `ROBOT_ID` or `NOTHING_ID`."""


class Renderer:
    """All cameras of a task on one picture scene.

    Args:
        task: Gives cameras, robot, shapes and workspace.
        cameras: Other cameras or another resolution; None takes the task's.
        device: Render device of SAPIEN: "cpu" (any Vulkan device without CUDA), "cuda", "cuda:1".

    Raises:
        SetupError: There is no usable Vulkan device.
    """

    def __init__(
        self, task: Task, cameras: CameraConfig | None = None, device: str = "cpu"
    ) -> None:
        self.task = task
        self.cameras = cameras or task.config.cameras
        self.parameters = camera_parameters(self.cameras)
        """Name to (K, T_world_camera), OpenCV, as they stand in the present scene."""
        self._scene = _picture_scene(device)
        self._robot = _load_robot(self._scene, task)
        self._table = sim.make_table(bodies=False, visuals=True)
        for entity in (self._table, sim.make_ground(bodies=False, visuals=True)):
            self._scene.add_entity(entity)
        self._lights = sim.add_lights(self._scene)
        self._components = self._add_cameras()
        self._decor: list[Any] = []
        self._looks = Looks()
        self._shapes = Shapes(task)
        self._objects: list[Any] = []
        self._movable: list[Any] = []
        self._object_index = np.zeros(0, dtype=np.int16)
        self._unseen = True
        self.scene: SceneSpec | None = None

    def set_scene(self, scene: SceneSpec, looks: Looks | None = None) -> None:
        """Take the objects and the looks of a scene in place of those of the scene before.

        Args:
            scene: What stands on the table.
            looks: What else is seen; None is the usual look. Errors of sensors are not the
                renderer's: `sensor_errors.py` adds them.
        """
        if (looks or Looks()) != self._looks:
            self._set_looks(looks or Looks(), scene.variant)
        for entity in self._objects:
            self._scene.remove_entity(entity)
        self._objects = [
            sim.make_object(obj, self._shapes.of(obj), bodies=False, visuals=True)
            for obj in scene.objects
        ]
        for entity in self._objects:
            self._scene.add_entity(entity)
        self._movable = [
            e for e, o in zip(self._objects, scene.objects, strict=True) if not o.fixed
        ]
        self._object_index = self._number_pixels()
        self._unseen = True
        self.scene = scene

    def _set_looks(self, looks: Looks, variant: str) -> None:
        for entity in (*self._decor, *(light.entity for light in self._lights)):
            self._scene.remove_entity(entity)
        self._lights = sim.add_lights(self._scene, looks.lights or sim.USUAL_LIGHTS)
        sim.paint_table(self._table, looks.table_rgb or sim.TABLE_COLOR_RGB)
        self._decor = [sim.make_prop(prop) for prop in looks.props]
        if looks.pad_rgb is not None:
            self._decor += [sim.make_pad(p, looks.pad_rgb) for p in self.task.pads(variant)]
        for entity in self._decor:
            self._scene.add_entity(entity)
        self.parameters = camera_parameters(looks.move_cameras(self.cameras))
        for name, (_, T_world_camera) in self.parameters.items():
            self._components[name].entity.set_pose(sapien_camera_pose(T_world_camera))
        self._looks = looks

    def render(self, moment: Moment) -> dict[str, Frame]:
        """Draw one state of the scene with every camera.

        Raises:
            RenderError: No scene is set, the moment is of another scene, or a camera shows nothing
                of the workspace in the scene's first picture.
        """
        self._place(moment)
        self._scene.update_render()
        # All pictures are requested before any is fetched: drawing then overlaps fetching.
        for component in self._components.values():
            component.take_picture()
        frames = {name: self._fetch(c) for name, c in self._components.items()}
        if self._unseen:
            self._check_views(frames)
            self._unseen = False
        return frames

    def _place(self, moment: Moment) -> None:
        if self.scene is None:
            raise RenderError("no scene is set; call set_scene before render")
        if len(moment.object_position_m) != len(self._movable):
            raise RenderError(
                f"the moment has {len(moment.object_position_m)} movable objects, scene "
                f"{self.scene.scene_id} has {len(self._movable)}; set the scene it was recorded in"
            )
        self._robot.set_qpos(moment.qpos.astype(np.float32))
        for entity, position, quat in zip(
            self._movable, moment.object_position_m, moment.object_quat_wxyz, strict=True
        ):
            entity.set_pose(sapien.Pose(position, quat))

    def _fetch(self, component: Any) -> Frame:
        # (H, W, 4) int16: red and green, blue and 255, depth in millimetres, number of the entity.
        seen = component.get_picture(SEEN)
        rgba = seen.view(np.uint8)
        return Frame(
            # Channel by channel, which takes a third of the time of copying `rgba[..., :3]`.
            rgb=np.stack([rgba[..., channel] for channel in range(3)], axis=-1),
            depth_m=seen[..., 2].astype(np.float32) * METRES_PER_MM,
            object_index=self._object_index.take(seen[..., 3]),
        )

    def _check_views(self, frames: Mapping[str, Frame]) -> None:
        box = self.task.config.workspace
        low, high = np.array(box.low_m), np.array(box.high_m)
        for name, frame in frames.items():
            K, T = self.parameters[name]
            points, _ = backproject_depth(frame.depth_m, K, T, max_depth_m=self.cameras.far_m)
            if not inside_box(points, low, high).any():
                view = next(v for v in self.cameras.views if v.name == name)
                raise RenderError(
                    f"camera '{name}' of {self.task.name} sees nothing of the workspace "
                    f"{list(box.low_m)} to {list(box.high_m)} m; it stands at "
                    f"{list(view.position_m)} and looks along {list(view.look)}: check "
                    "cameras.views in the task's YAML"
                )

    def _number_pixels(self) -> np.ndarray:
        """Table from the entity number in a picture to `Frame.object_index`."""
        entities = self._scene.entities
        table = np.full(max(e.per_scene_id for e in entities) + 1, NOTHING_ID, dtype=np.int16)
        for link in self._robot.links:
            table[link.entity.per_scene_id] = ROBOT_ID
        for row, entity in enumerate(self._objects):
            table[entity.per_scene_id] = row
        return table

    def _add_cameras(self) -> dict[str, Any]:
        config = self.cameras
        components = {}
        for name, (_, T_world_camera) in self.parameters.items():
            component = sapien.render.RenderCameraComponent(
                config.width, config.height, str(SHADERS)
            )
            component.set_fovy(config.fov_y_rad, compute_x=True)
            component.near, component.far = config.near_m, config.far_m
            entity = sapien.Entity()
            entity.name = name
            entity.add_component(component)
            entity.set_pose(sapien_camera_pose(T_world_camera))
            self._scene.add_entity(entity)
            components[name] = component
        return components


def _picture_scene(device: str) -> Any:
    """Empty scene that can draw; physics is there only to pose the robot's links."""
    try:
        system = sapien.render.RenderSystem(sapien.Device(device))
    except RuntimeError as error:
        raise SetupError(
            f"SAPIEN finds no Vulkan device for '{device}' ({error}); without a GPU install Mesa "
            "lavapipe >= 24.3, and run 'codediffuser doctor'"
        ) from None
    # These settings belong to the whole process and act on cameras made afterwards.
    sapien.render.set_picture_format(SEEN, "r16g16b16a16sint")
    sapien.render.set_msaa(1)
    return sapien.Scene([sapien.physx.PhysxCpuSystem(), system])


def _load_robot(scene: Any, task: Task) -> Any:
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    robot = loader.load(str(panda_urdf()))
    robot.set_root_pose(base_pose(task.config.robot))
    return robot
