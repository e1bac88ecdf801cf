"""Damage to training clouds, so that the policy lives with noisy points and wrong attention."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

ATTENDED = 0.5
OPEN = 0.8
"""Scaled opening beyond which the hand holds nothing and its fingers do not move."""
CLOSED = -0.5
"""Scaled opening below which the hand holds something."""
NEAR_M = 0.05
"""Distance over which the chance of a wrong point near the target falls by e."""


@dataclass(frozen=True, slots=True)
class Augmentation:
    """How often and how much."""

    swap_probability: float
    """Share of samples in which attended points are swapped for wrong ones."""
    swap_max_share: float
    """Largest share of each channel's attended points that is swapped."""
    drop_probability: float
    """Share of samples in which attended points lose their attention."""
    drop_max_share: float
    """Largest share of them that does."""
    point_noise_m: float
    """Standard deviation of the noise on coordinates."""


def augment_clouds(clouds: Tensor, options: Augmentation) -> Tensor:
    """Return damaged copies of clouds; randomness comes from torch's present generator.

    A swap takes attention from a share of the attended points and gives it to as many others on
    average: in half of the samples to any, in half to those near the target, which survive the
    cleaning of attention masks.

    Args:
        clouds: (B, To, N, 3 + C) float32: world metres, then attention.
        options: How much.
    """
    xyz, attention = clouds[..., :3], clouds[..., 3:]
    attended = attention > ATTENDED
    count = attended.sum(dim=2, keepdim=True)
    swap = _shares(clouds, options.swap_probability, options.swap_max_share)
    drop = _shares(clouds, options.drop_probability, options.drop_max_share)
    lost = attended & (torch.rand_like(attention) < 1 - (1 - swap) * (1 - drop))

    weight = torch.where(attended, 0.0, _nearness(xyz, attended, count))
    total = weight.sum(dim=2, keepdim=True).clamp_min(1e-6)
    gained = torch.rand_like(attention) < swap * count * weight / total

    attention = attention.masked_fill(lost, 0.0).masked_fill(gained, 1.0)
    xyz = xyz + options.point_noise_m * torch.randn_like(xyz)
    return torch.cat([xyz, attention], dim=-1)


def displace_hand(
    clouds: Tensor, actions: Tensor, opening: Tensor, *, probability: float, size_m: float
) -> tuple[Tensor, Tensor]:
    """Show the scene as if the open hand were elsewhere, with the actions that are then right.

    They are those that lead to the same places in the world, so a hand that is off comes back and
    grasps at the centre. A hand that holds something is left alone: where it has to go is known
    best from its own pose, which this would contradict, and it was seen to place less precisely.

    Args:
        clouds: (B, To, N, 3 + C) float32, world.
        actions: (B, T, 10), world.
        opening: (B,) present finger opening from -1 (as closed as ever seen) to 1.
        probability: Share of samples that are displaced.
        size_m: Standard deviation along each axis.

    Returns:
        Clouds and actions.
    """
    happens = (torch.rand_like(opening) < probability) & (opening > OPEN)
    offset = size_m * happens[:, None] * torch.randn(len(opening), 3, device=opening.device)
    clouds = torch.cat([clouds[..., :3] - offset[:, None, None], clouds[..., 3:]], dim=-1)
    return clouds, torch.cat([actions[..., :3] - offset[:, None], actions[..., 3:]], dim=-1)


def _shares(clouds: Tensor, probability: float, largest: float) -> Tensor:
    """One share per sample (B, 1, 1, 1), zero in all but `probability` of them."""
    shape = (len(clouds), 1, 1, 1)
    happens = torch.rand(shape, device=clouds.device) < probability
    return happens * largest * torch.rand(shape, device=clouds.device)


def _nearness(xyz: Tensor, attended: Tensor, count: Tensor) -> Tensor:
    """Weights (B, To, N, C) of becoming a wrong point: even, or falling with the distance."""
    weight = attended.to(xyz.dtype).transpose(2, 3)
    centers = (weight @ xyz) / count.transpose(2, 3).clamp_min(1)
    near = torch.exp(-torch.cdist(xyz, centers) / NEAR_M)
    is_near = torch.rand((len(xyz), 1, 1, 1), device=xyz.device) < 0.5
    return torch.where(is_near, near, 1.0)
