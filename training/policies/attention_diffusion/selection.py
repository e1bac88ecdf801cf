"""What the policy looks at: cleaned attention, centres of the targets, and a crop around them.

Only attention values and distances decide, never the order in which a cloud lists its points.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from codediffuser.training.policies.attention_diffusion.configuration_attention_diffusion import (
    AttentionDiffusionConfig,
)
from codediffuser.training.policies.attention_diffusion.neighbors import farthest_points, take

ATTENDED = 0.5
"""A point counts as attended above this attention."""
SEED_POINTS = 64
"""Attended points whose median starts the search for a centre: enough to outvote strays."""
MIN_TRIM_RADIUS_M = 0.02
"""Never trim closer than this: small targets keep all their points."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Part of M clouds, K points each, in the world; C attention channels."""

    xyz: Tensor
    """(M, K, 3) metres."""
    attention: Tensor
    """(M, K, C), strays set to 0."""
    attended: Tensor
    """(M, K, C) bool."""
    centers: Tensor
    """(M, C, 3) metres; meaningless where `present` is 0."""
    present: Tensor
    """(M, C) float, 1 where the channel has an attended point."""


def merge_channels(attention: Tensor, mode: str) -> Tensor:
    """Turn attention (M, N, roles) into the channels (M, N, C) of an `attention_channels` mode."""
    if mode == "merged":
        return attention.amax(dim=-1, keepdim=True)
    return torch.zeros_like(attention) if mode == "none" else attention


@torch.no_grad()
def find_centers(
    xyz: Tensor, attended: Tensor, trim_factor: float, generator: torch.Generator | None = None
) -> tuple[Tensor, Tensor]:
    """Find where each channel's target is, though some of its points lie elsewhere.

    The median of some attended points starts; then the mean of all within `trim_factor` median
    distances of it is taken, twice.

    Args:
        xyz: (M, N, 3) metres.
        attended: (M, N, C) bool.
        trim_factor: See `AttentionDiffusionConfig.trim_factor`; 0 takes the plain mean.
        generator: Source of the random subset.

    Returns:
        centers: (M, C, 3) metres, 0 for a channel without points.
        kept: (M, N, C) bool, `attended` without the strays.
    """
    mask = attended.transpose(1, 2)
    if trim_factor == 0:
        return _masked_mean(xyz, mask), attended
    keys = torch.rand(mask.shape, generator=generator, device=xyz.device)
    count = min(SEED_POINTS, xyz.shape[1])
    key, seeds = torch.where(mask, keys, -1.0).topk(count, dim=-1)
    seed_xyz = take(xyz, seeds).masked_fill((key < 0)[..., None], float("nan"))
    center = seed_xyz.transpose(-1, -2).nanmedian(dim=-1).values.nan_to_num(0.0)
    spread = (seed_xyz - center[..., None, :]).norm(dim=-1).nanmedian(dim=-1).values
    radius = (trim_factor * spread).clamp_min(MIN_TRIM_RADIUS_M)[..., None]
    kept = mask
    for _ in range(2):
        kept = mask & (torch.cdist(center, xyz) <= radius)
        # A ring around an empty middle may have no point near its median: keep what was there.
        kept = torch.where(kept.any(dim=-1, keepdim=True), kept, mask)
        center = _masked_mean(xyz, kept)
    return center, kept.transpose(1, 2)


def _masked_mean(xyz: Tensor, mask: Tensor) -> Tensor:
    weight = mask.to(xyz.dtype)
    return (weight @ xyz) / weight.sum(dim=-1, keepdim=True).clamp_min(1.0)


def tool_centers(state: Tensor, offset_m: float) -> Tensor:
    """Points (..., 3) between the finger tips, from hand poses (..., 10) in the world."""
    x, y = state[..., 3:6], state[..., 6:9]
    return state[..., :3] + offset_m * torch.linalg.cross(x, y)


def select(
    xyz: Tensor,
    attention: Tensor,
    tool: Tensor,
    closed: Tensor,
    config: AttentionDiffusionConfig,
    generator: torch.Generator | None = None,
) -> Selection:
    """Clean the attention, find the centres and crop.

    Args:
        xyz: (M, N, 3) metres, world.
        attention: (M, N, C) from `merge_channels`.
        tool: (M, 3) metres, world: the tool centre of each cloud's own moment.
        closed: (M,) bool: from these clouds points near the hand are taken, too.
        config: Options of the policy.
        generator: Source of the random crop.
    """
    centers, attended = find_centers(xyz, attention > ATTENDED, config.trim_factor, generator)
    attention = torch.where(attended | (attention <= ATTENDED), attention, 0.0)
    present = attended.any(dim=1).to(xyz.dtype)
    if not config.crop:
        return Selection(xyz, attention, attended, centers, present)
    index = _crop(xyz, attended, tool, closed, config, generator)
    attended = take(attended.to(xyz.dtype), index) > 0
    return Selection(take(xyz, index), take(attention, index), attended, centers, present)


@torch.no_grad()
def _crop(
    xyz: Tensor,
    attended: Tensor,
    tool: Tensor,
    closed: Tensor,
    config: AttentionDiffusionConfig,
    generator: torch.Generator | None,
) -> Tensor:
    """Indices (M, K) of the points to look at."""
    near = _near_hand(xyz, tool, config, generator)
    pick, place = config.crop_pick_points, config.crop_place_points
    if config.attention_channels == "none":
        # Clouds hold more points where attention is, so a random rest would give the targets away.
        return _join(farthest_points(xyz, pick + place), near, closed)
    quotas = [pick + place] if config.attention_channels == "merged" else [pick, place]
    groups = [
        _random_attended(attended[..., channel], quota, generator)
        for channel, quota in enumerate(quotas)
    ]
    return _join(torch.cat(groups, dim=1), near, closed)


def _join(targets: Tensor, near: Tensor, closed: Tensor) -> Tensor:
    """Both groups of indices; that of a hand that is not closed is filled with targets again.

    What lies near an open hand would show that `augment.displace_hand` moved it; what lies near a
    closed one shows how the thing in it stands to the place.
    """
    again = torch.arange(near.shape[1], device=near.device) % targets.shape[1]
    return torch.cat([targets, torch.where(closed[:, None], near, targets[:, again])], dim=1)


def _random_attended(mask: Tensor, count: int, generator: torch.Generator | None) -> Tensor:
    """Random attended points (M, count); too few are repeated, none at all become random others."""
    count = min(count, mask.shape[1])
    keys = torch.rand(mask.shape, generator=generator, device=mask.device)
    order = (keys + mask).topk(count, dim=1).indices
    found = mask.sum(dim=1, keepdim=True)
    slot = torch.arange(count, device=mask.device).expand(len(mask), -1)
    slot = torch.where(found > 0, slot % found.clamp(1, count), slot)
    return order.gather(1, slot)


def _near_hand(
    xyz: Tensor,
    tool: Tensor,
    config: AttentionDiffusionConfig,
    generator: torch.Generator | None,
) -> Tensor:
    """Random points within the hand's radius; if too few, the nearest beyond it."""
    beyond = (xyz - tool[:, None]).norm(dim=-1) - config.hand_radius_m
    keys = torch.rand(beyond.shape, generator=generator, device=xyz.device)
    keys = torch.where(beyond <= 0, keys, -beyond)
    return keys.topk(min(config.crop_hand_points, xyz.shape[1]), dim=1).indices
