"""From checked options to a policy and its processors."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from codediffuser.datasets.features import ACTION, POINTS, STATE
from codediffuser.errors import ConfigError, SetupError
from codediffuser.registry import unknown_name

if TYPE_CHECKING:
    from lerobot.configs.policies import PreTrainedConfig

TRAINABLE = ("attention_diffusion",)
"""Policies that our loop trains; stock `lerobot-train` trains the others."""
POSE_DIM = 10
NOT_OPTIONS = {"input_features", "output_features", "normalization_mapping", "pretrained_path"}


def policy_config(options: dict[str, Any], point_values: int, device: str) -> PreTrainedConfig:
    """Build a policy's LeRobot configuration.

    Args:
        options: `type` and options, as in `TrainConfig.policy`.
        point_values: Length N*5 of a flat cloud.
        device: Torch device.

    Raises:
        ConfigError: Unknown type or option, or a wrong value; closest names are given.
    """
    import draccus
    import torch
    from draccus.utils import DecodingError
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.configs.types import FeatureType, PolicyFeature

    import codediffuser.training.policies.attention_diffusion  # noqa: F401  registers it

    if device == "cuda" and not torch.cuda.is_available():
        raise SetupError(
            "device 'cuda' is asked for, but torch sees no GPU; give '--device cpu' or use preset "
            "'cpu'"
        )
    options = dict(options)
    kind = str(options.pop("type", "nothing"))
    if kind not in TRAINABLE:
        raise ConfigError(unknown_name("policy.type", kind, list(TRAINABLE)))
    config_class = PreTrainedConfig.get_choice_class(kind)
    known = sorted({f.name for f in dataclasses.fields(config_class)} - NOT_OPTIONS)
    for name in options:
        if name not in known:
            raise ConfigError(unknown_name(f"option of policy '{kind}'", name, known))
    try:
        config: PreTrainedConfig = draccus.parsers.decoding.decode(
            config_class, {"device": device, "push_to_hub": False} | options
        )
    except DecodingError as error:
        raise ConfigError(f"policy: {error}") from None
    config.input_features = {
        POINTS: PolicyFeature(FeatureType.STATE, (point_values,)),
        STATE: PolicyFeature(FeatureType.STATE, (POSE_DIM,)),
    }
    config.output_features = {ACTION: PolicyFeature(FeatureType.ACTION, (POSE_DIM,))}
    return config
