"""The built-in network: a small U-Net on colour, height, normals and distance, per pixel.

It gives each pixel an embedding on the unit sphere and a vote for the middle of its instance. It
works on the picture folded 2 x 2, so a quarter of the positions carry four pixels each.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812  torch's own habit

CUES = 9
"""Input channels: RGB, height, distance, normal (3), whether there is a reading."""
EMBEDDING = 16
VOTE = 3
WIDTHS = (32, 64, 96, 128)
SCALE = 16.0
"""Of the cosine in the softmax; the larger, the less near a pixel must come to its reference."""


def cues(images: Tensor, depth_m: Tensor, K: Tensor, T_world_camera: Tensor) -> Tensor:
    """Input channels of a batch of views.

    Args:
        images: (B, H, W, 3) uint8 RGB.
        depth_m: (B, H, W) float32 m, 0 or NaN for no reading.
        K: (B, 3, 3) float32.
        T_world_camera: (B, 4, 4) float32.

    Returns:
        (B, CUES, H, W) float32, each about -1 to 1. Normals are in a frame that stands upright and
        looks the camera's way: right, ahead, up. Nothing tells where in the room a pixel is but its
        height above the table.
    """
    depth = torch.nan_to_num(depth_m)
    valid = (depth > 0).float()
    points = _camera_points(depth, K)
    R = T_world_camera[:, :3, :3]
    world = torch.einsum("bij,bjhw->bihw", R, points)
    height = world[:, 2] + T_world_camera[:, 2, 3, None, None]
    upright = _upright(R)
    normal = torch.einsum("bij,bjhw->bihw", upright, _normals(world))
    rgb = images.permute(0, 3, 1, 2).float() / 127.5 - 1.0
    rest = torch.stack([(height / 0.2).clamp(-1, 2), (depth - 0.7) / 0.3], dim=1)
    return torch.cat([rgb, rest.clamp(-2, 2) * valid[:, None], normal * valid[:, None],
                      valid[:, None]], dim=1)  # fmt: skip


def _camera_points(depth: Tensor, K: Tensor) -> Tensor:
    """Points (B, 3, H, W) in camera coordinates."""
    v, u = torch.meshgrid(
        torch.arange(depth.shape[1], dtype=depth.dtype),
        torch.arange(depth.shape[2], dtype=depth.dtype),
        indexing="ij",
    )
    K4 = K[:, :, :, None, None]
    x = (u - K4[:, 0, 2]) / K4[:, 0, 0] * depth
    y = (v - K4[:, 1, 2]) / K4[:, 1, 1] * depth
    return torch.stack([x, y, depth], dim=1)


def _normals(points: Tensor) -> Tensor:
    """Unit normals (B, 3, H, W) from central differences, toward the camera; 0 at the border."""
    across = F.pad(points[..., :, 2:] - points[..., :, :-2], (1, 1, 0, 0))
    down = F.pad(points[..., 2:, :] - points[..., :-2, :], (0, 0, 1, 1))
    return F.normalize(torch.cross(down, across, dim=1), dim=1, eps=1e-9)


def _upright(R_world_camera: Tensor) -> Tensor:
    """Rotations (B, 3, 3) from the world to right, ahead, up of each camera."""
    up = torch.tensor([0.0, 0.0, 1.0]).expand(len(R_world_camera), 3)
    right = R_world_camera[:, :, 0] * torch.tensor([1.0, 1.0, 0.0])
    right = F.normalize(right, dim=1)
    ahead = torch.cross(up, right, dim=1)
    return torch.stack([right, ahead, up], dim=1)


class BuiltinNetwork(nn.Module):
    """See the module.

    Args:
        categories: Number of reference vectors, the background first.
    """

    def __init__(self, categories: int) -> None:
        super().__init__()
        stem, *deeper = WIDTHS
        self.stem = nn.Sequential(_block(4 * CUES, stem), _block(stem, stem))
        self.down = nn.ModuleList()
        self.up = nn.ModuleList()
        last = stem
        for width in deeper:
            self.down.append(nn.Sequential(nn.MaxPool2d(2), _block(last, width),
                                           _block(width, width)))  # fmt: skip
            self.up.append(_Up(width, last))
            last = width
        self.head = nn.Conv2d(stem, 4 * (EMBEDDING + VOTE), 1)
        self.references = nn.Parameter(torch.randn(categories, EMBEDDING))

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Unit embeddings (B, EMBEDDING, H, W) and votes (B, VOTE, H, W) of cues (B, CUES, H, W).

        H and W must divide by 16.
        """
        x = self.stem(F.pixel_unshuffle(inputs, 2))
        skips = [x]
        for down in self.down:
            x = down(x)
            skips.append(x)
        skips.pop()
        for up in reversed(self.up):
            x = up(x, skips.pop())
        out = F.pixel_shuffle(self.head(x), 2)
        return F.normalize(out[:, :EMBEDDING], dim=1), out[:, EMBEDDING:]

    def cosines(self, embeddings: Tensor) -> Tensor:
        """Cosine to each reference vector, (B, categories, H, W)."""
        unit = F.normalize(self.references, dim=1)
        return torch.einsum("ce,behw->bchw", unit, embeddings)


class _Up(nn.Module):
    """Doubles the resolution of what comes from below and joins it with what was there before."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.reduce = nn.Conv2d(inputs, outputs, 1)
        self.refine = _block(outputs, outputs)

    def forward(self, below: Tensor, before: Tensor) -> Tensor:
        larger = F.interpolate(self.reduce(below), scale_factor=2.0, mode="nearest")
        return self.refine(larger + before)  # type: ignore[no-any-return]


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )
