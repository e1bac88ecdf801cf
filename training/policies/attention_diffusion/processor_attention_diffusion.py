"""What happens to batches before and after the policy, saved with every checkpoint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from lerobot.configs.types import PipelineFeatureType, PolicyFeature
from lerobot.processor import (
    AddBatchDimensionProcessorStep,
    DeviceProcessorStep,
    NormalizerProcessorStep,
    ObservationProcessorStep,
    PolicyAction,
    PolicyProcessorPipeline,
    ProcessorStepRegistry,
    RenameObservationsProcessorStep,
    UnnormalizerProcessorStep,
)
from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action
from lerobot.utils.constants import (
    POLICY_POSTPROCESSOR_DEFAULT_NAME,
    POLICY_PREPROCESSOR_DEFAULT_NAME,
)

from codediffuser.datasets.features import POINTS, STATE
from codediffuser.training.policies.attention_diffusion.configuration_attention_diffusion import (
    AttentionDiffusionConfig,
)

ROBOT_STATE = "observation.robot_state"
"""Where LeRobot 0.4.4 leaves a nested gym observation; it drops unknown top-level keys."""


@dataclass
@ProcessorStepRegistry.register(name="codediffuser_unpack_points")
class UnpackPointsProcessorStep(ObservationProcessorStep):
    """Take points and state out of a nested robot state and make clouds flat and batched."""

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Return the observation with `observation.points` (B, [To,] N*5) float32."""
        nested = observation.pop(ROBOT_STATE, None)
        if isinstance(nested, dict):
            for name, key in (("points", POINTS), ("state", STATE)):
                if name in nested:
                    observation[key] = nested[name]
        for key in (POINTS, STATE):
            if key in observation:
                value = observation[key]
                tensor = torch.from_numpy(value) if isinstance(value, np.ndarray) else value
                observation[key] = tensor.to(torch.float32)
        if POINTS in observation:
            observation[POINTS] = _flat_batched(observation[POINTS], observation.get(STATE))
        return observation

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Features are named as in the dataset already."""
        return features


def _flat_batched(points: torch.Tensor, state: torch.Tensor | None) -> torch.Tensor:
    """Bring (N*5,), (B, N*5), (B, To, N*5) or the same with a split last axis to the flat form."""
    batch_axes = max(points.ndim - 1, 1) if state is None else state.ndim - 1
    if points.ndim > 1 and points.ndim == batch_axes + 2:
        points = points.flatten(-2)
    return points[None] if points.ndim == 1 else points


def make_attention_diffusion_pre_post_processors(
    config: AttentionDiffusionConfig,
    dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None,
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """Build both pipelines; LeRobot finds this function by its name.

    The normalising steps do nothing (identity) but stay in, because LeRobot's tools override them
    by name when a checkpoint is fine-tuned.

    Args:
        config: Options of the policy.
        dataset_stats: Kept for state and action only.
    """
    stats = {k: v for k, v in (dataset_stats or {}).items() if k != POINTS}
    features = {**(config.input_features or {}), **(config.output_features or {})}
    before = [
        RenameObservationsProcessorStep(rename_map={}),
        UnpackPointsProcessorStep(),
        AddBatchDimensionProcessorStep(),
        DeviceProcessorStep(device=config.device),
        NormalizerProcessorStep(
            features=features, norm_map=config.normalization_mapping, stats=stats
        ),
    ]
    after = [
        UnnormalizerProcessorStep(
            features=config.output_features, norm_map=config.normalization_mapping, stats=stats
        ),
        DeviceProcessorStep(device="cpu"),
    ]
    return (
        PolicyProcessorPipeline(steps=before, name=POLICY_PREPROCESSOR_DEFAULT_NAME),
        PolicyProcessorPipeline(
            steps=after,
            name=POLICY_POSTPROCESSOR_DEFAULT_NAME,
            to_transition=policy_action_to_transition,
            to_output=transition_to_policy_action,
        ),
    )
