"""The attention-conditioned diffusion policy, as LeRobot calls it."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import torch
from lerobot.policies.diffusion.modeling_diffusion import DiffusionConditionalUnet1d
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from codediffuser.datasets.features import ACTION, POINTS, STATE
from codediffuser.errors import ShapeError
from codediffuser.training.augment import CLOSED, Augmentation, augment_clouds, displace_hand
from codediffuser.training.policies.attention_diffusion import pointnet2  # noqa: F401  registers it
from codediffuser.training.policies.attention_diffusion.configuration_attention_diffusion import (
    NUM_POINT_CHANNELS,
    AttentionDiffusionConfig,
)
from codediffuser.training.policies.attention_diffusion.encoder import POINT_ENCODERS
from codediffuser.training.policies.attention_diffusion.frame import (
    POSE_DIM,
    PoseFrame,
    PoseRanges,
    measure_ranges,
    read_poses,
)
from codediffuser.training.policies.attention_diffusion.sampling import ActionDiffusion
from codediffuser.training.policies.attention_diffusion.selection import (
    merge_channels,
    select,
    tool_centers,
)

CENTER_SCALE_M = 0.1
"""Unit of the centres that condition the denoiser."""


class AttentionDiffusionPolicy(PreTrainedPolicy):
    """Diffusion of absolute hand poses, conditioned on attended points and proprioception.

    Args:
        config: Options with input and output features.
        dataset_stats: Not used: ranges depend on the policy's frame.
        dataset_meta: LeRobot metadata of a local dataset; the ranges are measured from its poses.
        ranges: Ranges already measured.
    """

    config_class = AttentionDiffusionConfig
    name = "attention_diffusion"

    def __init__(
        self,
        config: AttentionDiffusionConfig,
        dataset_stats: Any = None,
        dataset_meta: Any = None,
        ranges: PoseRanges | None = None,
        **_: Any,
    ) -> None:
        super().__init__(config)
        config.validate_features()
        self.config: AttentionDiffusionConfig = config
        channels = config.num_attention_channels
        self.frame = PoseFrame(config.frame)
        self.encoder = POINT_ENCODERS.get(config.encoder)(channels, config.encoder_dim)
        per_step = config.encoder_dim
        per_step += POSE_DIM if config.use_proprioception else 0
        per_step += 4 * channels if config.use_centroids else 0
        self.unet = DiffusionConditionalUnet1d(config, per_step * config.n_obs_steps)
        self.diffusion = ActionDiffusion(config)
        if ranges is None and dataset_meta is not None:
            state, action, starts = read_poses(Path(dataset_meta.root))
            ranges = measure_ranges(
                state, action, starts,
                frame=config.frame, n_obs_steps=config.n_obs_steps, horizon=config.horizon,
            )  # fmt: skip
        if ranges is not None:
            self.frame.set_ranges(ranges)
        self.reset()

    def get_optim_params(self) -> Any:
        """All parameters, one group."""
        return self.parameters()

    def reset(self, seed: int | None = None) -> None:
        """Forget observations and planned actions. Call it with every reset of the environment.

        Args:
            seed: Makes crops and sampling repeatable: same seed and observations, same actions.
        """
        self._observations: dict[str, deque[Tensor]] = {
            key: deque(maxlen=self.config.n_obs_steps) for key in (POINTS, STATE)
        }
        self._actions: deque[Tensor] = deque()
        self._generator: torch.Generator | None = None
        if seed is not None:
            self._generator = torch.Generator(device=self.config.device).manual_seed(seed)

    @property
    def needs_observation(self) -> bool:
        """Whether the next plan reads the present observation; if not, `select_action({})` does."""
        return len(self._actions) < self.config.n_obs_steps

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """Loss of a batch of windows.

        Args:
            batch: `observation.points` (B, To, N*5), `observation.state` (B, To, 10), `action`
                (B, T, 10), all absolute in the world, and with `mask_padded_actions` also
                `action_is_pad` (B, T).

        Returns:
            Mean squared error of the denoiser, and numbers for the log (none).
        """
        self.frame.check_ready()
        clouds = self._clouds(batch[POINTS])
        state, action = batch[STATE], batch[ACTION]
        origin = self.frame.origin(state)
        if self.training:
            clouds, action = self._augment(clouds, state, action)
        condition = self._condition(clouds, state, origin)
        loss = self.diffusion.loss(self.unet, self.frame.encode_action(action, origin), condition)
        if self.config.mask_padded_actions:
            real = ~batch["action_is_pad"][None, :, :, None].expand_as(loss)
            return (loss * real).sum() / real.sum().clamp_min(1), {}
        return loss.mean(), {}

    @torch.no_grad()
    def predict_action_chunk(
        self, batch: dict[str, Tensor], noise: Tensor | None = None, **_: Any
    ) -> Tensor:
        """Plan from a window, or from one observation taken as standing still.

        Args:
            batch: Points (B, To, N*5) and state (B, To, 10), or both without the time axis.
            noise: (B, horizon, 10) to start from; drawn when None.

        Returns:
            (B, n_action_steps, 10) absolute poses, the first for the present step.
        """
        self.frame.check_ready()
        points, state = batch[POINTS], batch[STATE]
        if state.ndim == 2:
            points, state = (
                x[:, None].expand(-1, self.config.n_obs_steps, *x.shape[1:])
                for x in (points, state)
            )
        origin = self.frame.origin(state)
        condition = self._condition(self._clouds(points), state, origin)
        if noise is None:
            noise = torch.randn(
                len(state), self.config.horizon, POSE_DIM,
                generator=self._generator, device=state.device,
            )  # fmt: skip
        chunk = self.diffusion.sample(self.unet, condition, noise, self._generator)
        chunk = self.frame.decode_action(chunk, origin)
        start = self.config.n_obs_steps - 1
        return chunk[:, start : start + self.config.n_action_steps]

    @torch.no_grad()
    def select_action(
        self, batch: dict[str, Tensor], noise: Tensor | None = None, **_: Any
    ) -> Tensor:
        """Give the action (B, 10) of this control step; plan anew when the last plan is used up.

        Args:
            batch: Points (B, N*5) and state (B, 10); may be empty unless `needs_observation`.
            noise: See `predict_action_chunk`.
        """
        for key, queue in self._observations.items():
            if key in batch:
                repeats = 1 if queue else self.config.n_obs_steps
                queue.extend([batch[key]] * repeats)
        if not self._actions:
            window = {key: torch.stack(list(q), dim=1) for key, q in self._observations.items()}
            self._actions.extend(self.predict_action_chunk(window, noise=noise).unbind(1))
        return self._actions.popleft()

    def _clouds(self, points: Tensor) -> Tensor:
        """(B, To, N*5) or (B, To, N, 5) to (B, To, N, 5)."""
        if points.ndim == 4 and points.shape[-1] == NUM_POINT_CHANNELS:
            return points
        if points.ndim != 3 or points.shape[-1] % NUM_POINT_CHANNELS:
            raise ShapeError(
                f"{POINTS}: expected (B, To, N*{NUM_POINT_CHANNELS}), got {tuple(points.shape)}"
            )
        return points.unflatten(-1, (-1, NUM_POINT_CHANNELS))

    def _condition(self, clouds: Tensor, state: Tensor, origin: Tensor) -> Tensor:
        """Encode (B, To, N, 5) and (B, To, 10) to the denoiser's condition (B, G)."""
        batch_size, steps = state.shape[:2]
        flat = clouds.flatten(0, 1)
        attention = merge_channels(flat[..., 3:], self.config.attention_channels)
        generator = None if self.training else self._generator
        tool = tool_centers(state, self.config.tool_offset_m).flatten(0, 1)
        closed = self._opening(state).flatten() < CLOSED
        chosen = select(flat[..., :3], attention, tool, closed, self.config, generator)
        center = origin.repeat_interleave(steps, dim=0)[:, None]
        parts = [self.encoder(chosen.xyz - center, chosen.attention, chosen.attended)]
        if self.config.use_centroids:
            centers = (chosen.centers - center) * chosen.present[..., None] / CENTER_SCALE_M
            parts += [centers.flatten(1), chosen.present]
        if self.config.use_proprioception:
            parts.append(self.frame.encode_state(state, origin).flatten(0, 1))
        return torch.cat(parts, dim=-1).reshape(batch_size, -1)

    def _opening(self, state: Tensor) -> Tensor:
        """Finger openings (B, To) from -1, as closed as ever seen, to 1."""
        return self.frame.encode_state(state, self.frame.origin(state))[..., -1]

    def _augment(self, clouds: Tensor, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        c = self.config
        options = Augmentation(
            swap_probability=c.augment_swap_probability,
            swap_max_share=c.augment_swap_max_share,
            drop_probability=c.augment_drop_probability,
            drop_max_share=c.augment_drop_max_share,
            point_noise_m=c.augment_point_noise_m,
        )
        opening = self._opening(state).amin(dim=1)
        return displace_hand(
            augment_clouds(clouds, options), action, opening,
            probability=c.augment_offset_probability, size_m=c.augment_offset_m,
        )  # fmt: skip
