"""Point encoders: a cloud with attention to one feature vector, and the small default one."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from codediffuser.registry import Registry


class PointEncoder(nn.Module, ABC):
    """Base of all encoders.

    Args:
        num_channels: Attention channels C.
        dim: Length D of the feature.
    """

    def __init__(self, num_channels: int, dim: int) -> None:
        super().__init__()
        self.num_channels, self.dim = num_channels, dim

    @abstractmethod
    def forward(self, xyz: Tensor, attention: Tensor, attended: Tensor) -> Tensor:
        """Encode M clouds.

        Args:
            xyz: (M, K, 3) metres in the policy's frame.
            attention: (M, K, C) in [0, 1].
            attended: (M, K, C) bool.

        Returns:
            (M, D).
        """


POINT_ENCODERS: Registry[type[PointEncoder]] = Registry("point encoder")


@POINT_ENCODERS.add("pointnet")
class PointNetEncoder(PointEncoder):
    """Shared layers per point, then a maximum over all points and one over each channel's own.

    Attention enters as point features and again as the masks of the pooling.
    """

    WIDTHS = (64, 64, 128)
    POINT_SCALE_M = 0.1
    """Unit of the coordinates inside: the size of what is looked at."""

    def __init__(self, num_channels: int, dim: int) -> None:
        super().__init__(num_channels, dim)
        layers: list[nn.Module] = []
        width_in = 3 + num_channels
        for width in self.WIDTHS:
            layers += [nn.Linear(width_in, width), nn.LayerNorm(width), nn.ReLU()]
            width_in = width
        self.point_layers = nn.Sequential(*layers)
        self.head = nn.Linear(width_in * (1 + num_channels), dim)

    def forward(self, xyz: Tensor, attention: Tensor, attended: Tensor) -> Tensor:
        """See `PointEncoder.forward`."""
        features = self.point_layers(torch.cat([xyz / self.POINT_SCALE_M, attention], dim=-1))
        everything = torch.ones_like(attended[..., :1])
        return self.head(masked_maximum(features, torch.cat([everything, attended], dim=-1)))


def masked_maximum(features: Tensor, masks: Tensor) -> Tensor:
    """Maximum over the points of each mask.

    Searching without gradients and gathering what was found halves the cost of a training step's
    pooling on a CPU: the gradient of a maximum would look through all points once more.

    Args:
        features: (M, K, F), >= 0 as after a ReLU.
        masks: (M, K, P) bool.

    Returns:
        (M, P * F), 0 for a mask without points.
    """
    with torch.no_grad():
        weights = masks.to(features.dtype).unbind(-1)
        found = [(features * w[..., None]).max(dim=1).indices for w in weights]
        # Where all of a mask's features are 0, a point outside it may be found: 0 as well.
        inside = [w.gather(1, index) for w, index in zip(weights, found, strict=True)]
    return (features.gather(1, torch.stack(found, dim=1)) * torch.stack(inside, dim=1)).flatten(1)
