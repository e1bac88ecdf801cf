"""Attention-conditioned diffusion policy; importing it registers the type `attention_diffusion`."""

from codediffuser.training.policies.attention_diffusion.configuration_attention_diffusion import (
    AttentionDiffusionConfig,
)

__all__ = ["AttentionDiffusionConfig"]
