"""Batched point-set operations in torch: even sampling, neighbours within a radius, gathering."""

from __future__ import annotations

import torch
from torch import Tensor


def take(values: Tensor, index: Tensor) -> Tensor:
    """Gather rows: values (M, N, F), index (M, ...) -> (M, ..., F)."""
    flat = index.reshape(len(index), -1)
    rows = values.gather(1, flat[..., None].expand(-1, -1, values.shape[-1]))
    return rows.reshape(*index.shape, values.shape[-1])


@torch.no_grad()
def farthest_points(xyz: Tensor, count: int) -> Tensor:
    """Choose evenly spread points: (M, N, 3) -> indices (M, min(count, N)).

    Starts at the point farthest from the mean, so the order of points does not matter.
    """
    if xyz.shape[1] <= count:
        return torch.arange(xyz.shape[1], device=xyz.device).expand(len(xyz), -1)
    rows = torch.arange(len(xyz), device=xyz.device)
    chosen = (xyz - xyz.mean(dim=1, keepdim=True)).square().sum(-1).argmax(dim=1)
    indices = [chosen]
    gap = xyz.new_full(xyz.shape[:2], float("inf"))
    for _ in range(count - 1):
        gap = torch.minimum(gap, (xyz - xyz[rows, chosen][:, None]).square().sum(-1))
        chosen = gap.argmax(dim=1)
        indices.append(chosen)
    return torch.stack(indices, dim=1)


@torch.no_grad()
def neighbors_within(centers: Tensor, xyz: Tensor, radius_m: float, count: int) -> Tensor:
    """Nearest `count` points within a radius of each centre: (M, Q, 3), (M, N, 3) -> (M, Q, count).

    Where fewer lie within the radius the nearest one fills the rest, which changes no maximum.
    """
    distance, index = torch.cdist(centers, xyz).topk(
        min(count, xyz.shape[1]), dim=-1, largest=False
    )
    return torch.where(distance <= radius_m, index, index[..., :1])
