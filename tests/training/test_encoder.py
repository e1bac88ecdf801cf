from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from codediffuser.errors import NotRegisteredError
from codediffuser.training.policies.attention_diffusion import pointnet2
from codediffuser.training.policies.attention_diffusion.encoder import (
    POINT_ENCODERS,
    PointEncoder,
    PointNetEncoder,
    masked_maximum,
)

NAMES = POINT_ENCODERS.names()


def inputs(seed: int = 0, channels: int = 2) -> tuple[Tensor, Tensor, Tensor]:
    rng = torch.Generator().manual_seed(seed)
    xyz = 0.1 * torch.rand(2, 60, 3, generator=rng)
    attention = torch.zeros(2, 60, channels)
    attention[:, :20, 0] = 1
    attention[:, 20:35, -1] = 1
    return xyz, attention, attention > 0.5


def build(name: str, channels: int = 2) -> PointEncoder:
    torch.manual_seed(0)
    return POINT_ENCODERS.get(name)(channels, 32).eval()


def stages(encoder: nn.Module) -> list[nn.Module]:
    if isinstance(encoder, pointnet2.PointNet2Encoder):
        return [encoder.stage1.layers, encoder.stage2.layers, encoder.stage3.layers]
    assert isinstance(encoder, PointNetEncoder)
    return [encoder.point_layers]


@pytest.mark.parametrize("name", NAMES)
def test_attention_reaches_every_stage_and_is_not_zero(name: str) -> None:
    encoder, seen = build(name), []
    for stage in stages(encoder):
        stage.register_forward_pre_hook(lambda _, args: seen.append(args[0][..., -2:]))
    encoder(*inputs())
    assert len(seen) == len(stages(encoder))
    for attention in seen:
        for channel in range(2):
            assert attention[..., channel].abs().sum() > 0
            assert attention[..., channel].std() > 0


@pytest.mark.parametrize("name", NAMES)
def test_each_stage_alone_passes_attention_on_to_the_output(name: str) -> None:
    # Attention is wiped at one stage's input after another: every time the output must change.
    xyz, attention, attended = inputs()
    encoder = build(name)
    whole = encoder(xyz, attention, attended)
    for stage in stages(encoder):

        def wipe(_: nn.Module, args: tuple[Tensor]) -> tuple[Tensor]:
            return (torch.cat([args[0][..., :-2], torch.zeros_like(args[0][..., -2:])], dim=-1),)

        handle = stage.register_forward_pre_hook(wipe)
        changed = encoder(xyz, attention, attended)
        handle.remove()
        assert (whole - changed).abs().max() > 1e-6  # exactly 0 where it is not wired


@pytest.mark.parametrize("name", NAMES)
def test_gradients_reach_attention_and_every_weight(name: str) -> None:
    xyz, attention, attended = inputs()
    attention.requires_grad_()
    encoder = build(name)
    encoder(xyz, attention, attended).square().sum().backward()
    assert attention.grad is not None and attention.grad.abs().sum() > 0
    for weight in encoder.parameters():
        assert weight.grad is not None and weight.grad.abs().sum() > 0


@pytest.mark.parametrize("name", NAMES)
def test_encoders_do_not_depend_on_the_order_of_points(name: str) -> None:
    encoder = build(name)
    order = torch.randperm(60, generator=torch.Generator().manual_seed(1))
    plain, mixed = (encoder(*(x[:, i] for x in inputs())) for i in (slice(None), order))
    assert torch.allclose(plain, mixed, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_no_attended_point_gives_a_finite_feature(name: str) -> None:
    xyz, attention, attended = inputs()
    assert build(name)(xyz, 0 * attention, attended & False).isfinite().all()


def test_pointnet2_has_the_size_of_the_released_encoder() -> None:
    encoder = pointnet2.PointNet2Encoder(1, 256)
    assert sum(p.numel() for p in encoder.parameters()) == 1_459_200


def test_masked_maximum_equals_the_plain_one_in_value_and_gradient() -> None:
    features = (torch.rand(3, 9, 5) - 0.5).clamp_min(0).requires_grad_()
    masks = torch.rand(3, 9, 2) > 0.7
    masks[0, :, 1] = False
    ours = masked_maximum(features, masks)
    plain = torch.cat([(features * masks[..., c, None]).amax(dim=1) for c in range(2)], dim=-1)
    assert torch.equal(ours, plain)
    (ours_grad,) = torch.autograd.grad(ours.square().sum(), features)
    (plain_grad,) = torch.autograd.grad(plain.square().sum(), features)
    # The plain gradient is divided among equals, which matters only where the ReLU stops it anyway.
    assert torch.allclose(ours_grad[features > 0], plain_grad[features > 0])


def test_unknown_encoder_names_the_closest() -> None:
    with pytest.raises(NotRegisteredError, match="Did you mean 'pointnet2'"):
        POINT_ENCODERS.get("pointnet22")
