"""From absolute world poses to what the network sees and back: hand-centred, in [-1, 1]."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from codediffuser.datasets import parquet_reader
from codediffuser.datasets.features import ACTION, STATE
from codediffuser.errors import ConfigError

POSE_DIM = 10
MIN_RANGE = 0.01
"""A dimension that moves less (m, rotation-6D) is not stretched: that would amplify its noise."""


@dataclass(frozen=True, slots=True)
class PoseRanges:
    """Smallest and largest value of each dimension in the policy's frame, (10,) float32 each."""

    state_low: np.ndarray
    state_high: np.ndarray
    action_low: np.ndarray
    action_high: np.ndarray


def measure_ranges(
    state: np.ndarray,
    action: np.ndarray,
    episode_starts: np.ndarray,
    *,
    frame: str,
    n_obs_steps: int,
    horizon: int,
) -> PoseRanges:
    """Go through all windows of a dataset, as the sampler cuts them.

    Args:
        state: (F, 10) float32 measured hand poses, world.
        action: (F, 10) float32 commanded hand poses, world.
        episode_starts: (E + 1,) first frame of each episode, then F.
        frame: `hand` or `world`, see `AttentionDiffusionConfig.frame`.
        n_obs_steps: Observations per window; the present frame is the last of them.
        horizon: Actions per window; the first belongs to the oldest observation.
    """
    now = np.arange(len(state))
    episode = np.searchsorted(episode_starts, now, side="right") - 1
    first, last = episode_starts[episode], episode_starts[episode + 1] - 1

    def bounds(values: np.ndarray, offsets: range) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.full(POSE_DIM, np.inf), np.full(POSE_DIM, -np.inf)
        for offset in offsets:
            moved = values[np.clip(now + offset, first, last)].astype(np.float64)
            if frame == "hand":
                moved[:, :3] -= state[:, :3]
            low, high = np.minimum(low, moved.min(axis=0)), np.maximum(high, moved.max(axis=0))
        return low.astype(np.float32), high.astype(np.float32)

    oldest = 1 - n_obs_steps
    return PoseRanges(
        *bounds(state, range(oldest, 1)), *bounds(action, range(oldest, oldest + horizon))
    )


def read_poses(root: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read state (F, 10), action (F, 10) and episode starts (E + 1,) of a LeRobot v3 folder.

    Only these columns are read, so this takes a moment even when the clouds are large.

    Raises:
        DatasetError: The folder is no such dataset.
    """
    batches = list(parquet_reader.read_frames(root, {STATE: POSE_DIM, ACTION: POSE_DIM}))
    rows = parquet_reader.read_episode_rows(root)
    starts = [int(row["dataset_from_index"]) for row in rows]
    state, action = (np.concatenate([b[key] for b in batches]) for key in (STATE, ACTION))
    return state, action, np.array([*starts, len(state)])


class PoseFrame(nn.Module):
    """Moves poses to the policy's frame and scales them; its ranges are saved with the weights.

    Args:
        frame: `hand` or `world`.
    """

    state_low: Tensor
    state_high: Tensor
    action_low: Tensor
    action_high: Tensor

    def __init__(self, frame: str) -> None:
        super().__init__()
        self.frame = frame
        for name in ("state_low", "state_high", "action_low", "action_high"):
            self.register_buffer(name, torch.full((POSE_DIM,), float("nan")))

    def set_ranges(self, ranges: PoseRanges) -> None:
        """Take ranges over, in place."""
        for name, buffer in self.named_buffers():
            buffer.copy_(torch.from_numpy(getattr(ranges, name)))

    def check_ready(self) -> None:
        """Raise `ConfigError` while the ranges are unknown."""
        if any(bool(buffer.isnan().any()) for buffer in self.buffers()):
            raise ConfigError(
                "attention_diffusion has no action ranges yet: train it (codediffuser train), "
                "load a checkpoint, or build it with dataset_meta of a local dataset"
            )

    def origin(self, state: Tensor) -> Tensor:
        """World position (B, 3) of the frame: the hand's in the last of `state` (B, To, 10)."""
        position = state[:, -1, :3]
        return position if self.frame == "hand" else torch.zeros_like(position)

    def encode_state(self, state: Tensor, origin: Tensor) -> Tensor:
        """(B, To, 10) world to about [-1, 1]."""
        center, half = _center_half(self.state_low, self.state_high)
        return (_shift(state, -origin) - center) / half

    def encode_action(self, action: Tensor, origin: Tensor) -> Tensor:
        """(B, T, 10) world to [-1, 1]."""
        center, half = _center_half(self.action_low, self.action_high)
        return (_shift(action, -origin) - center) / half

    def decode_action(self, action: Tensor, origin: Tensor) -> Tensor:
        """(B, T, 10) of the network to the world."""
        center, half = _center_half(self.action_low, self.action_high)
        return _shift(action * half + center, origin)


def _center_half(low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    width = high - low
    return (high + low) / 2, torch.where(width < MIN_RANGE, torch.ones_like(width), width) / 2


def _shift(poses: Tensor, offset: Tensor) -> Tensor:
    return torch.cat([poses[..., :3] + offset[:, None], poses[..., 3:]], dim=-1)
