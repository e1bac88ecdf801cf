"""The only builder of SAPIEN bodies: table, ground, objects, lights, and a view of their state.

The physics scene (`envs.py`) and the picture scene (`rendering.py`) take their bodies from here,
so both show the same world.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien
import trimesh
from sapien import physx
from trimesh.graph import smooth_shade

from codediffuser.datagen.appearance import DirectionalLight, Lights, Prop
from codediffuser.datagen.props import prop_mesh
from codediffuser.datagen.scene import ObjectSpec, SceneSpec, Vector3
from codediffuser.datagen.task import Decal, Geometry, Pad
from codediffuser.datagen.views import Moment, MomentView

SIM_HZ = 250
SETTLE_STEPS = 100
"""Physics steps after a reset, 0.4 s: bodies come to rest before the first action."""

TABLE_HALF_SIZE_M = (0.35, 0.70, 0.025)
TABLE_CENTER_M = (0.0, 0.30, -0.025)
TABLE_COLOR_RGB = (0.55, 0.44, 0.34)
GROUND_Z_M = -1.0
GROUND_COLOR_RGB = (0.28, 0.29, 0.31)
CREASE_RAD = 0.5
"""Edges sharper than this stay sharp in pictures."""

PAD_THICKNESS_M = 0.0005
"""Of a randomised pad above the table: too little for depth, enough to be drawn."""

USUAL_LIGHTS = Lights(
    ambient_rgb=(0.45, 0.45, 0.45),
    directional=(
        DirectionalLight(direction=(0.3, 0.6, -1.0), color_rgb=(1.1, 1.1, 1.1)),
        DirectionalLight(direction=(-0.6, -0.4, -0.7), color_rgb=(0.6, 0.6, 0.6)),
    ),
)
"""Even light, unless an episode's appearance says otherwise."""


def make_object(obj: ObjectSpec, geometry: Geometry, *, bodies: bool, visuals: bool) -> Any:
    """Build one object of a scene as a SAPIEN entity at its reset pose.

    Args:
        obj: What it is and where it stands.
        geometry: Its shape, from the task.
        bodies: Whether it collides and moves.
        visuals: Whether it is seen; needs a renderer.
    """
    entity = sapien.Entity()
    entity.name = obj.id
    if visuals:
        visual = _mesh_visual(geometry.visual, obj.color_rgb)
        for decal in geometry.decals:
            visual.attach(_decal_shape(decal))
        entity.add_component(visual)
    if bodies:
        entity.add_component(_rigid_body(obj, geometry))
    entity.pose = sapien.Pose(np.array(obj.position_m), np.array(obj.quat_wxyz))
    return entity


def make_table(*, bodies: bool, visuals: bool) -> Any:
    """Build the table; its top is the plane z = 0."""
    entity = sapien.Entity()
    entity.name = "table"
    if visuals:
        visual = sapien.render.RenderBodyComponent()
        visual.attach(
            sapien.render.RenderShapeBox(TABLE_HALF_SIZE_M, _material(TABLE_COLOR_RGB, 0.8))
        )
        entity.add_component(visual)
    if bodies:
        body = physx.PhysxRigidStaticComponent()
        material = physx.PhysxMaterial(1.0, 0.5, 0.01)
        body.attach(physx.PhysxCollisionShapeBox(TABLE_HALF_SIZE_M, material))
        entity.add_component(body)
    entity.pose = sapien.Pose(TABLE_CENTER_M)
    return entity


def paint_table(table: Any, color_rgb: Vector3) -> None:
    """Give the table of `make_table(visuals=True)` another colour."""
    visual = table.find_component_by_type(sapien.render.RenderBodyComponent)
    for shape in visual.render_shapes:
        shape.material.base_color = [*color_rgb, 1.0]


def make_ground(*, bodies: bool, visuals: bool) -> Any:
    """Build the floor of the room, which catches what falls off the table."""
    half_size = (4.0, 4.0, 0.05)
    entity = sapien.Entity()
    entity.name = "ground"
    if visuals:
        visual = sapien.render.RenderBodyComponent()
        visual.attach(sapien.render.RenderShapeBox(half_size, _material(GROUND_COLOR_RGB, 1.0)))
        entity.add_component(visual)
    if bodies:
        body = physx.PhysxRigidStaticComponent()
        material = physx.PhysxMaterial(1.0, 1.0, 0.0)
        body.attach(physx.PhysxCollisionShapeBox(half_size, material))
        entity.add_component(body)
    entity.pose = sapien.Pose([0.0, 0.0, GROUND_Z_M - half_size[2]])
    return entity


def add_lights(scene: Any, lights: Lights = USUAL_LIGHTS) -> list[Any]:
    """Light a scene without shadows, which would double the cost of a picture.

    Returns:
        What the scene made of each directional light.
    """
    scene.set_ambient_light(list(lights.ambient_rgb))
    return [
        scene.add_directional_light(list(light.direction), list(light.color_rgb))
        for light in lights.directional
    ]


def make_prop(prop: Prop) -> Any:
    """Build a thing that is seen and touches nothing."""
    entity = sapien.Entity()
    entity.name = prop.shape
    entity.add_component(_mesh_visual(prop_mesh(prop), prop.color_rgb))
    entity.pose = sapien.Pose(np.array(prop.position_m), np.array(prop.quat_wxyz))
    return entity


def make_pad(pad: Pad, color_rgb: Vector3) -> Any:
    """Build a task's pad as a sheet that is seen and touches nothing."""
    low, high = np.array(pad.low_m), np.array(pad.high_m)
    half = np.array([*(high - low) / 2, PAD_THICKNESS_M])
    entity = sapien.Entity()
    entity.name = pad.name
    visual = sapien.render.RenderBodyComponent()
    visual.attach(sapien.render.RenderShapeBox(half, _material(color_rgb, 0.9)))
    entity.add_component(visual)
    entity.pose = sapien.Pose(np.array([*(low + high) / 2, 0.0]))
    return entity


def _rigid_body(obj: ObjectSpec, geometry: Geometry) -> Any:
    body = physx.PhysxRigidStaticComponent() if obj.fixed else physx.PhysxRigidDynamicComponent()
    material = physx.PhysxMaterial(
        geometry.static_friction, geometry.dynamic_friction, geometry.restitution
    )
    for part in geometry.collision:
        shape = physx.PhysxCollisionShapeConvexMesh(
            vertices=np.asarray(part.vertices, dtype=np.float32),
            scale=np.ones(3, dtype=np.float32),
            material=material,
        )
        shape.density = geometry.density_kgm3
        body.attach(shape)
    if not obj.fixed:
        body.angular_damping = geometry.angular_damping_per_s
    return body


def _mesh_visual(mesh: trimesh.Trimesh, color_rgb: tuple[float, float, float]) -> Any:
    shaded = smooth_shade(mesh, angle=CREASE_RAD)
    shape = sapien.render.RenderShapeTriangleMesh(
        vertices=np.asarray(shaded.vertices, dtype=np.float32),
        triangles=np.asarray(shaded.faces, dtype=np.uint32),
        normals=np.asarray(shaded.vertex_normals, dtype=np.float32),
        uvs=np.zeros((len(shaded.vertices), 2), dtype=np.float32),
        material=_material(color_rgb, 0.6),
    )
    visual = sapien.render.RenderBodyComponent()
    visual.attach(shape)
    return visual


def _decal_shape(decal: Decal) -> Any:
    opaque = np.full((*decal.image_rgb.shape[:2], 1), 255, dtype=np.uint8)
    image = np.concatenate([decal.image_rgb, opaque], axis=-1)
    # Smaller copies of the picture keep fine print from flickering in small renders.
    levels = int(np.log2(min(image.shape[:2]))) + 1
    material = _material((1.0, 1.0, 1.0), 0.6)
    material.base_color_texture = sapien.render.RenderTexture2D(
        image, "R8G8B8A8Unorm", levels, "linear", "edge", True
    )
    return sapien.render.RenderShapeTriangleMesh(
        vertices=np.asarray(decal.mesh.vertices, dtype=np.float32),
        triangles=np.asarray(decal.mesh.faces, dtype=np.uint32),
        normals=np.asarray(decal.mesh.vertex_normals, dtype=np.float32),
        uvs=np.asarray(decal.uv, dtype=np.float32),
        material=material,
    )


def _material(color_rgb: tuple[float, float, float], roughness: float) -> Any:
    material = sapien.render.RenderMaterial()
    material.base_color = [*color_rgb, 1.0]
    material.roughness = roughness
    material.specular = 0.3
    return material


class SimView:
    """`SceneView` of a running simulation, on raw SAPIEN handles.

    Args:
        scene: The configuration that was reset to.
        robot: The arm.
        hand: Its link `panda_hand`.
        bodies: Rigid body of every movable object, by id, in the order of the scene.
    """

    def __init__(self, scene: SceneSpec, robot: Any, hand: Any, bodies: dict[str, Any]) -> None:
        self._scene = scene
        self._robot = robot
        self._hand = hand.entity
        self._bodies = bodies

    @property
    def scene(self) -> SceneSpec:
        """The configuration that was reset to."""
        return self._scene

    @property
    def object_ids(self) -> tuple[str, ...]:
        """Ids of the movable objects, in the order of a moment's rows."""
        return tuple(self._bodies)

    def moment(self) -> Moment:
        """Copy the present state."""
        n = len(self._bodies)
        position, quat = np.empty((n, 3)), np.empty((n, 4))
        velocity = np.empty((n, 6))
        for i, body in enumerate(self._bodies.values()):
            pose = body.entity.pose
            position[i], quat[i] = pose.p, pose.q
            velocity[i, :3], velocity[i, 3:] = body.linear_velocity, body.angular_velocity
        hand = self._hand.pose
        return Moment(
            object_position_m=position,
            object_quat_wxyz=quat,
            object_velocity=velocity,
            qpos=np.array(self._robot.qpos, dtype=np.float64),
            qvel=np.array(self._robot.qvel, dtype=np.float64),
            hand_position_m=np.array(hand.p, dtype=np.float64),
            hand_quat_wxyz=np.array(hand.q, dtype=np.float64),
        )

    def T_world_object(self, object_id: str) -> np.ndarray:
        """Pose (4, 4) float64 of a movable object now."""
        return self._now().T_world_object(object_id)

    def object_speed(self, object_id: str) -> tuple[float, float]:
        """Linear m/s and angular rad/s of a movable object now."""
        return self._now().object_speed(object_id)

    def T_world_hand(self) -> np.ndarray:
        """Pose (4, 4) float64 of `panda_hand` now."""
        return self._now().T_world_hand()

    def gripper_opening_m(self) -> float:
        """Mean opening of the two fingers now, 0 to 0.04 m each."""
        return self._now().gripper_opening_m()

    def _now(self) -> MomentView:
        return MomentView(self._scene, self.object_ids, self.moment())
