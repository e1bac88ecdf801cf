"""Our environments as a LeRobot `--env.type`; light, the simulator is imported when one is made."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_STATE

POSE_DIM = 10


def _features() -> dict[str, PolicyFeature]:
    return {
        ACTION: PolicyFeature(FeatureType.ACTION, (POSE_DIM,)),
        "agent_pos": PolicyFeature(FeatureType.STATE, (POSE_DIM,)),
    }


@EnvConfig.register_subclass("codediffuser")
@dataclass
class CodediffuserEnv(EnvConfig):
    """Environment of one task with attention on the scene's own target.

    Run few at a time (`--eval.batch_size=1`): each draws five cameras at every step.
    """

    task: str | None = "PackBatteryAttended-v1"
    """Id without its namespace, see `training.attention_env`."""
    fps: int = 25
    features: dict[str, PolicyFeature] = field(default_factory=_features)
    features_map: dict[str, str] = field(
        default_factory=lambda: {ACTION: ACTION, "agent_pos": OBS_STATE}
    )
    dataset: str | None = None
    """Root of the export that the policy was trained on: its clouds are made in the same way."""
    render_mode: str = "rgb_array"
    width: int | None = None
    """Pixels of each camera across, as in the demonstrations; None takes the task's."""
    height: int | None = None

    @property
    def package_name(self) -> str:
        """Module that registers the ids; LeRobot imports it when it misses one."""
        return "codediffuser.training.attention_env"

    @property
    def gym_id(self) -> str:
        """Id for `gymnasium.make`."""
        return f"codediffuser/{self.task}"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Options of `AttentionEnv`."""
        return {
            "dataset": self.dataset,
            "render_mode": self.render_mode,
            "width": self.width,
            "height": self.height,
        }
