"""Diffusion over action chunks: the training loss and the sampler."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812  the field's own name
from torch import Tensor, nn

from codediffuser.training.policies.attention_diffusion.configuration_attention_diffusion import (
    AttentionDiffusionConfig,
)


class ActionDiffusion:
    """Noise schedules of one configuration; holds no weights.

    Args:
        config: Options of the policy.
    """

    def __init__(self, config: AttentionDiffusionConfig) -> None:
        from diffusers.schedulers.scheduling_ddim import DDIMScheduler
        from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

        self.config = config
        options: dict[str, Any] = {
            "num_train_timesteps": config.num_train_timesteps,
            "beta_start": config.beta_start,
            "beta_end": config.beta_end,
            "beta_schedule": config.beta_schedule,
            "prediction_type": config.prediction_type,
            "clip_sample": True,
        }
        self._train = DDPMScheduler(**options)
        self._sample = (
            DDIMScheduler(**options)
            if config.inference_scheduler == "DDIM"
            else DDPMScheduler(**options)
        )

    def loss(self, unet: nn.Module, actions: Tensor, condition: Tensor) -> Tensor:
        """Squared error of the denoiser, with `noise_draws` draws per chunk.

        Args:
            unet: Denoiser (x, timestep, global_cond) -> like x.
            actions: (B, T, A) scaled chunks.
            condition: (B, G), encoded once for all draws.

        Returns:
            (draws, B, T, A), not reduced.
        """
        draws = self.config.noise_draws
        clean = actions.repeat(draws, 1, 1)
        noise = torch.randn_like(clean)
        steps = torch.randint(
            0, self.config.num_train_timesteps, (len(clean),), device=clean.device
        )
        noisy = self._train.add_noise(clean, noise, steps)
        predicted = unet(noisy, steps, global_cond=condition.repeat(draws, 1))
        target = clean if self.config.prediction_type == "sample" else noise
        return F.mse_loss(predicted, target, reduction="none").unflatten(0, (draws, -1))

    @torch.no_grad()
    def sample(
        self, unet: nn.Module, condition: Tensor, noise: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Denoise chunks.

        Args:
            unet: See `loss`.
            condition: (B, G).
            noise: (B, T, A) standard normal to start from.
            generator: Source of the noise that DDPM adds on the way.

        Returns:
            (B, T, A) scaled chunks.
        """
        self._sample.set_timesteps(self.config.num_inference_steps)
        actions = noise
        for step in self._sample.timesteps:
            steps = torch.full((len(actions),), int(step), device=actions.device)
            predicted = unet(actions, steps, global_cond=condition)
            actions = self._sample.step(predicted, step, actions, generator=generator).prev_sample
        return actions
