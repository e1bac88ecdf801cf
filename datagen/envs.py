"""Every task as a ManiSkill environment: `pack_battery` is `gym.make("PackBattery-v1")`.

An episode is a function of its `SceneSpec` and its actions alone: each reset builds the whole
PhysX scene again, since contact caches of an earlier episode would change the last bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs import Actor
from mani_skill.utils.structs.types import DefaultMaterialsConfig, SceneConfig, SimConfig

import codediffuser.datagen.tasks  # noqa: F401  fills TASKS
from codediffuser.datagen import sim
from codediffuser.datagen.cameras import T_world_camera, sapien_camera_pose
from codediffuser.datagen.known_shapes import Shapes
from codediffuser.datagen.robot import HAND_LINK, ROBOT_UID, base_pose
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import TASKS, Check, Task, get_task
from codediffuser.datagen.trajectory import CONTROL_HZ
from codediffuser.errors import ConfigError
from codediffuser.seeding import Stage


class SceneEnv(BaseEnv):
    """One task in one PhysX scene on the CPU.

    Reset to a given scene with `reset(options={"scene": scene})`; without one, a scene is drawn
    from the seed. Success is judged on the pairs that the scene's instruction allows.

    Args:
        task: Registered name, or a task with its own configuration.
        scene: First scene; None draws one.
        variant: Which ranges of the task's YAML scenes are drawn from.
        num_envs: Only 1; run several processes for more.
        sim_backend: Only the CPU.
        render_backend: "none" for physics alone, which then needs no Vulkan.
    """

    SUPPORTED_ROBOTS = [ROBOT_UID]  # noqa: RUF012  ManiSkill's own declaration
    SUPPORTED_REWARD_MODES = ("sparse", "none")

    agent: Any
    scene: Any
    scene_spec: SceneSpec
    """The configuration that was reset to last."""
    view: sim.SimView
    """What scripts and checks see of the present state."""

    def __init__(
        self,
        *args: Any,
        task: str | Task,
        scene: SceneSpec | None = None,
        variant: str = "sim",
        num_envs: int = 1,
        robot_uids: str = ROBOT_UID,
        sim_backend: str = "physx_cpu",
        **kwargs: Any,
    ) -> None:
        if num_envs != 1 or sim_backend not in ("auto", "cpu", "physx_cpu"):
            raise ConfigError(
                f"expected sim_backend 'physx_cpu' with num_envs 1, got '{sim_backend}' with "
                f"{num_envs}: hand poses are solved on the CPU, one scene per process; for more "
                "throughput start several processes"
            )
        self.task = get_task(task) if isinstance(task, str) else task
        self._shapes = Shapes(self.task)
        self._variant = variant
        self._wanted_scene = scene
        self._draws = 0
        super().__init__(
            *args, num_envs=1, robot_uids=robot_uids, sim_backend="physx_cpu", **kwargs
        )

    @property
    def _default_sim_config(self) -> SimConfig:
        # SAPIEN's own values, by which gains and friction were chosen; ManiSkill's differ. Two of
        # PhysX's options are off, as in the reference: with the temporal Gauss-Seidel solver one
        # battery in thirty never comes to rest in its cell but wobbles from wall to wall, with
        # persistent contact manifolds alone still one in a hundred; without both none in 500.
        return SimConfig(
            sim_freq=sim.SIM_HZ,
            control_freq=CONTROL_HZ,
            scene_config=SceneConfig(
                contact_offset=0.01,
                solver_position_iterations=10,
                enable_tgs=False,
                enable_pcm=False,
            ),
            default_materials_config=DefaultMaterialsConfig(restitution=0.1),
        )

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        cameras = self.task.config.cameras
        return [
            CameraConfig(
                uid=view.name,
                pose=sapien_camera_pose(T_world_camera(view)),
                width=cameras.width,
                height=cameras.height,
                fov=cameras.fov_y_rad,
                near=cameras.near_m,
                far=cameras.far_m,
            )
            for view in cameras.views
        ]

    @property
    def _default_human_render_camera_configs(self) -> list[CameraConfig]:
        first = self.task.config.cameras.views[0]
        return [
            CameraConfig(
                uid="render_camera",
                pose=sapien_camera_pose(T_world_camera(first)),
                width=640,
                height=480,
                fov=self.task.config.cameras.fov_y_rad,
                near=0.05,
                far=10.0,
            )
        ]

    def reset(
        self, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Build the scene again and let it settle.

        Args:
            seed: Of the drawn scene, when none is given.
            options: `scene` is the `SceneSpec` to reset to, or its content as a mapping, as
                exported trajectories hold it; the rest is ManiSkill's.
        """
        options = dict(options or {})
        given = options.pop("scene", None)
        if isinstance(given, dict):
            given = SceneSpec.parse(given, "reset options: scene")
        if given is not None and given.task != self.task.name:
            raise ConfigError(
                f"scene {given.scene_id} is of task '{given.task}', this environment is of "
                f"'{self.task.name}'"
            )
        if seed is not None:
            self._root_seed, self._draws = int(np.ravel(seed)[0]), 0
        first, self._wanted_scene = self._wanted_scene, None
        self.scene_spec = given or first or self._draw_scene()
        return super().reset(seed=seed, options={**options, "reconfigure": True})

    def _draw_scene(self) -> SceneSpec:
        from codediffuser.datagen.scene_sampler import sample_scene

        self._draws += 1
        return sample_scene(
            self.task,
            root_seed=self._root_seed,
            index=self._draws - 1,
            stage=Stage.ENV,
            variant=self._variant,
        )

    def _clear(self) -> None:
        # ManiSkill collects all garbage at every reset, two thirds of a reset's time, for the sake
        # of graphics memory. Physics alone frees little, and Python's own collector finds it.
        if self.backend.render_device is not None:
            super()._clear()
            return
        self.agent = self.scene = None

    def _load_agent(self, options: dict[str, Any]) -> None:
        super()._load_agent(options, base_pose(self.task.config.robot))

    def _load_scene(self, options: dict[str, Any]) -> None:
        visuals = self.scene.can_render()
        self._add_actor(sim.make_table(bodies=True, visuals=visuals), "table")
        self._add_actor(sim.make_ground(bodies=True, visuals=visuals), "ground")
        movable = {}
        for obj in self.scene_spec.objects:
            entity = sim.make_object(obj, self._shapes.of(obj), bodies=True, visuals=visuals)
            self._add_actor(entity, obj.id)
            if not obj.fixed:
                movable[obj.id] = entity.find_component_by_type(
                    sapien.physx.PhysxRigidDynamicComponent
                )
        robot = self.agent.robot
        self._physx_robot = robot._objs[0]
        self._hand = robot.links_map[HAND_LINK]._objs[0]
        self._active_joints = self._physx_robot.get_active_joints()
        self.view = sim.SimView(self.scene_spec, self._physx_robot, self._hand, movable)

    def _add_actor(self, entity: sapien.Entity, name: str) -> None:
        """Enter a plain SAPIEN entity into ManiSkill's scene, as its own builder would."""
        entity.name = f"scene-0_{name}"
        self.scene.sub_scenes[0].add_entity(entity)
        actor = Actor.create_from_entities(
            [entity], self.scene, torch.zeros(1, dtype=torch.int), shared_name=name
        )
        actor.initial_pose = actor.pose
        self.scene.actors[name] = actor
        self.scene.add_to_state_dict_registry(actor)

    def _load_lighting(self, options: dict[str, Any]) -> None:
        sim.add_lights(self.scene)

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        qpos = np.array(self.task.config.robot.initial_qpos, dtype=np.float32)
        self._physx_robot.set_qpos(qpos)
        self._physx_robot.set_qvel(np.zeros_like(qpos))
        for joint, target in zip(self._active_joints, qpos, strict=True):
            joint.set_drive_target(target)
        for _ in range(sim.SETTLE_STEPS):
            self.scene.px.step()

    def control_step(self, action: np.ndarray) -> None:
        """Do what `step` does to the simulation, without tensors, observations and rewards.

        Args:
            action: (10,) float32, see `ACTION_NAMES`.
        """
        self.agent.controller.command(action)
        step = self.scene.px.step
        for _ in range(self._sim_steps_per_control):
            step()
        self._elapsed_steps += 1

    @property
    def ik_failures(self) -> int:
        """Control steps since the reset whose pose could not be reached."""
        return int(self.agent.controller.ik_failures)

    def check(self) -> Check:
        """Judge the present state by what the instruction allows."""
        return self.task.check_success(self.view, self.scene_spec.instruction.pairs)

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Success, and value and verdict of each of its conditions, as (1,) tensors."""
        check = self.check()
        info = {"success": torch.tensor([check.success])}
        for condition in check.conditions:
            info[condition.name] = torch.tensor([condition.value])
            info[f"{condition.name}_ok"] = torch.tensor([condition.holds])
        return info

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        moment = self.view.moment()
        target = self.scene_spec.target
        row = self.view.object_ids.index(target.pick)
        place = np.array(self.scene_spec.place(target.place).position_m)
        parts = {
            "hand_pose": np.concatenate([moment.hand_position_m, moment.hand_quat_wxyz]),
            "pick_pose": np.concatenate(
                [moment.object_position_m[row], moment.object_quat_wxyz[row]]
            ),
            "place_position": place,
        }
        return {k: torch.from_numpy(v.astype(np.float32))[None] for k, v in parts.items()}


def physics_env(task: str | Task, scene: SceneSpec | None = None) -> SceneEnv:
    """Environment for the physics phase: no observations, no renderer, no Vulkan.

    Args:
        task: Registered name, or a task with its own configuration.
        scene: What it is reset to at once; None draws one.
    """
    return SceneEnv(task=task, scene=scene, obs_mode="none", render_backend="none")


def env_id(task_name: str) -> str:
    """ManiSkill id of a task: `pack_battery` -> `PackBattery-v1`."""
    return "".join(word.capitalize() for word in task_name.split("_")) + "-v1"


def _register(task_name: str) -> None:
    name = env_id(task_name)
    cls = type(name.removesuffix("-v1") + "Env", (SceneEnv,), {"__module__": __name__})
    # gymnasium finds the class by its module and name.
    globals()[cls.__name__] = cls
    max_steps = TASKS.get(task_name).load_config().max_steps
    register_env(name, max_episode_steps=max_steps, task=task_name)(cls)


for _name in TASKS.names():
    _register(_name)
