"""Tasks as gymnasium environments whose observation is the policy's cloud, attention included.

`codediffuser/PackBatteryAttended-v1` is what stock `lerobot-eval` runs a policy in. Attention lies
on the scene's own target: this measures motion. `codediffuser eval` goes from the instruction.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from codediffuser.datagen.envs import env_id
from codediffuser.datagen.gym_env import TaskEnv
from codediffuser.datagen.rendering import Renderer
from codediffuser.datagen.task import TASKS, get_task
from codediffuser.datagen.views import state_row
from codediffuser.datasets.clouds import CloudConfig, View, cloud_rng, policy_cloud
from codediffuser.datasets.export_meta import cloud_config
from codediffuser.errors import LabelError
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.ground_truth import ground_truth_labels
from codediffuser.pointcloud import crop_box, fuse_views

MAX_DRAWS = 20
"""Scenes to draw until one shows enough of its target to the cameras."""


class AttentionEnv(gym.Wrapper[dict[str, Any], np.ndarray, dict[str, Any], np.ndarray]):
    """A task whose `robot_state.points` (N, 5) float32 are world xyz in metres and attention.

    `agent_pos` (10,) float32 is the measured hand pose and finger opening.

    Args:
        task: Registered name.
        dataset: Export whose cloud configuration to use; None takes the defaults.
        render_mode: "rgb_array" or None.
        width: Pixels of each camera across; None takes the task's.
        height: Pixels down; None takes the task's.
    """

    def __init__(
        self,
        task: str,
        *,
        dataset: str | Path | None = None,
        render_mode: str | None = None,
        width: int | None = None,
        height: int | None = None,
    ) -> None:
        self._task = get_task(task)
        config = self._task.config.cameras
        cameras = config.model_copy(
            update={"width": width or config.width, "height": height or config.height}
        )
        self._inner = TaskEnv(self._task, obs="state", render_mode=render_mode, cameras=cameras)
        super().__init__(self._inner)
        self._renderer = Renderer(self._task, cameras)
        self._config = cloud_config(Path(dataset)) if dataset else CloudConfig()
        self._field: AttentionField | None = None
        self._step = 0
        points = spaces.Box(-np.inf, np.inf, (self._config.num_points, 5), np.float32)
        self.observation_space = spaces.Dict(
            {
                "agent_pos": spaces.Box(-np.inf, np.inf, (10,), np.float32),
                "robot_state": spaces.Dict({"points": points}),
            }
        )

    @property
    def task(self) -> str:
        """Name of the task."""
        return self._inner.task

    @property
    def task_description(self) -> str:
        """The instruction of the present scene."""
        return self._inner.task_description

    @property
    def _max_episode_steps(self) -> int:
        """Steps after which an episode ends; LeRobot asks for it under this name."""
        return self._inner._max_episode_steps

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; scenes whose target the cameras hardly see are drawn again.

        Raises:
            LabelError: The scene that was asked for, or every one that was drawn, hides its target.
        """
        _, info = self._inner.reset(seed=seed, options=options)
        for draw in range(MAX_DRAWS):
            try:
                self._field = self._attend()
                break
            except LabelError:
                if options is not None or draw == MAX_DRAWS - 1:
                    raise
                _, info = self._inner.reset()
        self._step = 0
        return self._observe(), info

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Command the hand for one control step, see `TaskEnv.step`."""
        _, reward, terminated, truncated, info = self._inner.step(action)
        self._step += 1
        return self._observe(), float(reward), terminated, truncated, info

    def _attend(self) -> AttentionField:
        """Put attention on the scene's target, as far as the cameras see it now."""
        scene = self._inner.sim.scene_spec
        self._renderer.set_scene(scene)
        low, high = self._workspace()
        cloud = crop_box(fuse_views(self._views()), low, high)
        poses = self._poses()
        labels = ground_truth_labels(self._task, scene, poses, cloud)
        return AttentionField(labels, poses, radius_m=self._config.attention_radius_m)

    def _observe(self) -> dict[str, Any]:
        assert self._field is not None
        sim = self._inner.sim
        seed, low_high = sim.scene_spec.seed, self._workspace()
        points = policy_cloud(
            self._views(), self._field, self._poses(), sim.view.T_world_hand(), *low_high,
            cloud_rng(seed.root, seed.index, self._step), self._config,
        )  # fmt: skip
        return {"agent_pos": state_row(sim.view.moment()), "robot_state": {"points": points}}

    def _views(self) -> list[View]:
        frames = self._renderer.render(self._inner.sim.view.moment())
        parameters = self._renderer.parameters
        return [View(frames[name].depth_m, K, T) for name, (K, T) in parameters.items()]

    def _poses(self) -> Mapping[str, np.ndarray]:
        view = self._inner.sim.view
        return {name: view.T_world_object(name) for name in view.object_ids}

    def _workspace(self) -> tuple[np.ndarray, np.ndarray]:
        box = self._task.config.workspace
        return np.array(box.low_m), np.array(box.high_m)


def attended_id(task_name: str) -> str:
    """Id for `gymnasium.make`: `pack_battery` -> `codediffuser/PackBatteryAttended-v1`."""
    name, version = env_id(task_name).rsplit("-", 1)
    return f"codediffuser/{name}Attended-{version}"


for _name in TASKS.names():
    # LeRobot reads attributes of the environment itself, so no wrapper may stand before it.
    gym.register(
        id=attended_id(_name),
        entry_point=f"{__name__}:AttentionEnv",
        kwargs={"task": _name},
        order_enforce=False,
        disable_env_checker=True,
    )
