"""PointNet++ with the attention handed on to every stage, as the paper describes it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from codediffuser.training.policies.attention_diffusion.encoder import POINT_ENCODERS, PointEncoder
from codediffuser.training.policies.attention_diffusion.neighbors import (
    farthest_points,
    neighbors_within,
    take,
)


class SetAbstraction(nn.Module):
    """One stage: centres, their neighbourhoods, shared layers, maximum.

    Args:
        num_centers: Centres to keep; None gathers all points around one centre at the origin.
        radius_m: Reach of a neighbourhood.
        num_neighbors: Points per neighbourhood.
        feature_dim: Length of the incoming point features, 0 for none.
        num_channels: Attention channels.
        widths: Output sizes of the shared layers.
    """

    def __init__(
        self,
        num_centers: int | None,
        radius_m: float,
        num_neighbors: int,
        feature_dim: int,
        num_channels: int,
        widths: tuple[int, ...],
    ) -> None:
        super().__init__()
        self.num_centers, self.radius_m, self.num_neighbors = num_centers, radius_m, num_neighbors
        layers: list[nn.Module] = []
        width_in = 3 + feature_dim + num_channels
        for width in widths:
            layers += [nn.Linear(width_in, width), nn.ReLU()]
            width_in = width
        self.layers = nn.Sequential(*layers)

    def forward(
        self, xyz: Tensor, features: Tensor, attention: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Pool neighbourhoods.

        Args:
            xyz: (M, N, 3) metres.
            features: (M, N, F).
            attention: (M, N, C), given to the layers beside the features.

        Returns:
            Centres (M, Q, 3), features (M, Q, widths[-1]) and mean attention (M, Q, C) of the
            neighbourhoods.
        """
        if self.num_centers is None:
            centers = torch.zeros_like(xyz[:, :1])
            index = torch.arange(xyz.shape[1], device=xyz.device).expand(len(xyz), 1, -1)
        else:
            centers = take(xyz, farthest_points(xyz, self.num_centers))
            index = neighbors_within(centers, xyz, self.radius_m, self.num_neighbors)
        group_attention = take(attention, index)
        relative = take(xyz, index) - centers[:, :, None]
        group = torch.cat([relative, take(features, index), group_attention], dim=-1)
        return centers, self.layers(group).amax(dim=2), group_attention.mean(dim=2)


@POINT_ENCODERS.add("pointnet2")
class PointNet2Encoder(PointEncoder):
    """Three stages and three layers; no normalisation, as in the release.

    With one channel and D = 256 it has the 1,459,200 parameters of the released encoder, whose
    attention residual carried zeros. Here it carries the attention.

    Source: Qi et al., PointNet++, 2017; sizes from the CodeDiffuser release.
    """

    DROPOUT = 0.4

    def __init__(self, num_channels: int, dim: int) -> None:
        super().__init__(num_channels, dim)
        self.stage1 = SetAbstraction(512, 0.02, 32, 0, num_channels, (64, 64, 128))
        self.stage2 = SetAbstraction(128, 0.045, 64, 128, num_channels, (128, 128, 256))
        self.stage3 = SetAbstraction(None, 0.0, 0, 256, num_channels, (256, 512, 1024))
        self.head = nn.Sequential(
            nn.Linear(1024, 512), nn.ReLU(), nn.Dropout(self.DROPOUT), nn.Linear(512, dim)
        )

    def forward(self, xyz: Tensor, attention: Tensor, attended: Tensor) -> Tensor:
        """See `PointEncoder.forward`."""
        features = xyz.new_zeros(*xyz.shape[:2], 0)
        for stage in (self.stage1, self.stage2, self.stage3):
            xyz, features, attention = stage(xyz, features, attention)
        return self.head(features[:, 0])
