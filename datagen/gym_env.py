"""Every task as a plain gymnasium environment: `codediffuser/PackBattery-v1`.

NumPy in and out, one scene, 10-D actions. Key names are those that LeRobot's evaluation passes on
to a policy: `agent_pos`, `pixels`, `robot_state`.
"""

from __future__ import annotations

import string
from typing import Any, ClassVar, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from codediffuser.datagen.controllers import action_space
from codediffuser.datagen.envs import SceneEnv, env_id, physics_env
from codediffuser.datagen.rendering import Frame, Renderer
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import TASKS, Task, get_task
from codediffuser.datagen.task_config import CameraConfig
from codediffuser.datagen.trajectory import CONTROL_HZ
from codediffuser.datagen.views import state_row
from codediffuser.errors import ConfigError, ShapeError
from codediffuser.pointcloud import crop_box, farthest_point_indices, fuse_views
from codediffuser.seeding import Stage, int_seed

ObsKind = Literal["state", "points", "images"]
MAX_INSTRUCTION = 400
"""Characters that an instruction may have; a bound that gymnasium's text space asks for."""


class TaskEnv(gym.Env[dict[str, Any], np.ndarray]):
    """One task, judged by its instruction.

    Observations: `agent_pos` (10,) float32 is the measured hand pose and finger opening, laid out
    like the action; `instruction` the sentence. With `points`, `robot_state.points` (N, 3) float32
    are evenly spread points of the workspace in the world, in metres. With `images`, `pixels` holds
    (H, W, 3) uint8 per camera. Reward is 1 in a state of success, else 0.

    An episode runs for its full length unless `terminate_on_success` is set, since success is
    judged on the last state.

    Args:
        task: Registered name, or a task with its own configuration.
        obs: What to observe besides state and instruction.
        num_points: N of the point cloud.
        render_mode: "rgb_array" or None.
        render_camera: Camera that `render` shows; None takes the task's first.
        cameras: Other cameras or another resolution; None takes the task's.
        max_steps: Steps after which an episode is cut; None takes the task's.
        variant: Which ranges of the task's YAML scenes are drawn from.
        terminate_on_success: Whether the first state of success ends the episode.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_HZ,
    }

    def __init__(
        self,
        task: str | Task,
        *,
        obs: ObsKind = "state",
        num_points: int = 1024,
        render_mode: str | None = None,
        render_camera: str | None = None,
        cameras: CameraConfig | None = None,
        max_steps: int | None = None,
        variant: str = "sim",
        terminate_on_success: bool = False,
    ) -> None:
        if obs not in ("state", "points", "images"):
            raise ConfigError(f"obs: expected 'state', 'points' or 'images', got '{obs}'")
        self._task = get_task(task) if isinstance(task, str) else task
        self.task = self._task.name
        """Name of the task."""
        self.render_mode = render_mode
        self._obs, self._num_points = obs, num_points
        self._cameras = cameras or self._task.config.cameras
        self._render_camera = render_camera or self._cameras.views[0].name
        self._max_episode_steps = max_steps or self._task.config.max_steps
        self._variant, self._terminate = variant, terminate_on_success
        self._sim: SceneEnv | None = None
        self._renderer: Renderer | None = None
        self._frames: dict[str, Frame] | None = None
        self._steps = 0
        self.action_space = action_space()
        self.observation_space = self._make_observation_space()

    @property
    def task_description(self) -> str:
        """The instruction of the present scene; empty before the first reset."""
        return "" if self._sim is None else self._sim.scene_spec.instruction.text

    @property
    def sim(self) -> SceneEnv:
        """The simulation behind it; reset first."""
        if self._sim is None:
            raise ConfigError("this environment has no scene yet; call reset before anything else")
        return self._sim

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Of the drawn scenes, this one and those after it.
            options: `scene`: the `SceneSpec` to reset to instead of a drawn one.
        """
        super().reset(seed=seed)
        scene = (options or {}).get("scene") or self._draw_scene()
        if self._sim is None:
            self._sim = physics_env(self._task, scene)
        else:
            self._sim.reset(options={"scene": scene})
        if self._renderer is not None:
            self._renderer.set_scene(scene)
        self._steps, self._frames = 0, None
        return self._observe(), self._info()

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Command the hand for one control step of 40 ms.

        Args:
            action: (10,) float32, see `ACTION_NAMES`.

        Raises:
            ShapeError: The action has another shape or is not finite.
        """
        action = np.asarray(action, dtype=np.float32)
        if action.shape != (10,) or not np.isfinite(action).all():
            raise ShapeError(
                f"{self.task} step {self._steps}: expected an action of 10 finite numbers, got "
                f"shape {action.shape} with values {np.array2string(action, precision=3)}"
            )
        self.sim.control_step(action)
        self._steps, self._frames = self._steps + 1, None
        info = self._info()
        success = info["is_success"]
        truncated = self._steps >= self._max_episode_steps
        return self._observe(), float(success), self._terminate and success, truncated, info

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Picture (H, W, 3) uint8 of the present state by the render camera."""
        if self.render_mode is None:
            return None
        frames = self._pictures()
        if self._render_camera not in frames:
            raise ConfigError(
                f"render_camera: no camera '{self._render_camera}'; known: {', '.join(frames)}"
            )
        return frames[self._render_camera].rgb

    def close(self) -> None:
        """Free the simulation and the pictures' scene."""
        if self._sim is not None:
            self._sim.close()
        self._sim = self._renderer = self._frames = None

    def _draw_scene(self) -> SceneSpec:
        root_seed = int_seed(self.np_random)
        return sample_scene(
            self._task, root_seed=root_seed, index=0, stage=Stage.ENV, variant=self._variant
        )

    def _info(self) -> dict[str, Any]:
        check = self.sim.check()
        return {
            "is_success": bool(check.success),
            "conditions": {c.name: float(c.value) for c in check.conditions},
            "failed_conditions": check.reason,
            "ik_failures": self.sim.ik_failures,
        }

    def _observe(self) -> dict[str, Any]:
        seen: dict[str, Any] = {
            "agent_pos": state_row(self.sim.view.moment()),
            "instruction": self.task_description,
        }
        if self._obs == "points":
            seen["robot_state"] = {"points": self._points()}
        elif self._obs == "images":
            seen["pixels"] = {name: frame.rgb for name, frame in self._pictures().items()}
        return seen

    def _points(self) -> np.ndarray:
        """Evenly spread points (num_points, 3) of the workspace; too few are repeated in turn."""
        renderer_views = self._pictures()
        assert self._renderer is not None
        cloud = fuse_views(
            (renderer_views[name].depth_m, K, T)
            for name, (K, T) in self._renderer.parameters.items()
        )
        box = self._task.config.workspace
        cloud = crop_box(cloud, np.array(box.low_m), np.array(box.high_m))
        chosen = farthest_point_indices(cloud, self._num_points)
        return cloud[np.resize(chosen, self._num_points)]

    def _pictures(self) -> dict[str, Frame]:
        """Draw the present state, at most once."""
        if self._renderer is None:
            self._renderer = Renderer(self._task, self._cameras)
            self._renderer.set_scene(self.sim.scene_spec)
        if self._frames is None:
            self._frames = self._renderer.render(self.sim.view.moment())
        return self._frames

    def _make_observation_space(self) -> spaces.Dict:
        parts: dict[str, spaces.Space[Any]] = {
            "agent_pos": spaces.Box(-np.inf, np.inf, (10,), np.float32),
            "instruction": spaces.Text(MAX_INSTRUCTION, min_length=0, charset=string.printable),
        }
        if self._obs == "points":
            points = spaces.Box(-np.inf, np.inf, (self._num_points, 3), np.float32)
            parts["robot_state"] = spaces.Dict({"points": points})
        elif self._obs == "images":
            shape = (self._cameras.height, self._cameras.width, 3)
            parts["pixels"] = spaces.Dict(
                {view.name: spaces.Box(0, 255, shape, np.uint8) for view in self._cameras.views}
            )
        return spaces.Dict(parts)


def gym_id(task_name: str) -> str:
    """Id of a task for `gymnasium.make`: `pack_battery` -> `codediffuser/PackBattery-v1`."""
    return f"codediffuser/{env_id(task_name)}"


for _name in TASKS.names():
    gym.register(id=gym_id(_name), entry_point=f"{__name__}:TaskEnv", kwargs={"task": _name})
