from __future__ import annotations

import pytest
import torch

from codediffuser.training.policies.attention_diffusion.configuration_attention_diffusion import (
    AttentionDiffusionConfig,
)
from codediffuser.training.policies.attention_diffusion.neighbors import (
    farthest_points,
    neighbors_within,
)
from codediffuser.training.policies.attention_diffusion.selection import (
    find_centers,
    merge_channels,
    select,
    tool_centers,
)

HAND = torch.tensor([[0.0, 0.0, 0.3]])
OPENED, CLOSED = torch.tensor([False]), torch.tensor([True])
PICK, PLACE = torch.tensor([0.1, 0.0, 0.03]), torch.tensor([-0.1, 0.1, 0.02])


def options(**changes: object) -> AttentionDiffusionConfig:
    counts = {"crop_pick_points": 12, "crop_place_points": 8, "crop_hand_points": 10}
    return AttentionDiffusionConfig(device="cpu", **(counts | changes))


def cloud(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """(1, 120, 3) points, 30 each at pick, place, hand and anywhere, and their attention."""
    rng = torch.Generator().manual_seed(seed)
    spread = torch.tensor([0.02, 0.02, 0.05, 0.3]).repeat_interleave(30)[:, None]
    centers = torch.stack([PICK, PLACE, HAND[0], torch.zeros(3)]).repeat_interleave(30, dim=0)
    xyz = centers + spread * (2 * torch.rand(120, 3, generator=rng) - 1)
    attention = torch.zeros(120, 2)
    attention[:30, 0] = 1
    attention[30:60, 1] = 1
    return xyz[None], attention[None]


def test_crop_takes_attended_points_and_points_near_the_hand() -> None:
    xyz, attention = cloud()
    chosen = select(xyz, attention, HAND, CLOSED, options())
    assert chosen.xyz.shape == (1, 30, 3)
    assert chosen.attended[0, :12, 0].all() and chosen.attended[0, 12:20, 1].all()
    assert ((chosen.xyz[0, 20:] - HAND).norm(dim=-1) <= 0.12).all()


@pytest.mark.parametrize("mode", ["separate", "merged", "none"])
def test_an_open_hand_hides_the_points_near_it(mode: str) -> None:
    xyz, attention = cloud()
    values = merge_channels(attention, mode)
    config = options(attention_channels=mode, crop_hand_points=30)
    counts = []
    for closed in (OPENED, CLOSED):
        seed = torch.Generator().manual_seed(2)
        chosen = select(xyz, values, HAND, closed, config, seed)
        counts.append(int(((chosen.xyz[0, 20:] - HAND).norm(dim=-1) <= 0.12).sum()))
        assert chosen.xyz.shape == (1, 50, 3)
    assert counts[1] == 30 and counts[0] < 15


def test_crop_does_not_depend_on_the_order_of_points() -> None:
    xyz, attention = cloud()
    config = options(crop_hand_points=30)
    order = torch.randperm(120, generator=torch.Generator().manual_seed(3))
    for points, values in ((xyz, attention), (xyz[:, order], attention[:, order])):
        chosen = select(points, values, HAND, CLOSED, config)
        near = {tuple(p) for p in xyz[0][(xyz[0] - HAND).norm(dim=-1) <= 0.12].tolist()}
        assert {tuple(p) for p in chosen.xyz[0, 20:].tolist()} <= near
        assert chosen.attended[0, :20].any(dim=-1).all()


def test_too_few_attended_points_are_repeated() -> None:
    xyz, attention = cloud()
    attention[0, 3:, 0] = 0
    chosen = select(xyz, attention, HAND, CLOSED, options())
    assert {tuple(p) for p in chosen.xyz[0, :12].tolist()} == {
        tuple(p) for p in xyz[0, :3].tolist()
    }


def test_a_channel_without_points_is_reported_absent_and_harms_nothing() -> None:
    xyz, attention = cloud()
    attention[..., 1] = 0
    chosen = select(xyz, attention, HAND, CLOSED, options())
    assert chosen.present.tolist() == [[1.0, 0.0]]
    assert chosen.xyz.isfinite().all() and chosen.centers.isfinite().all()


def test_ablation_none_sees_no_attention_and_crops_without_it() -> None:
    xyz, attention = cloud()
    blind = merge_channels(attention, "none")
    config = options(attention_channels="none")
    one = select(xyz, blind, HAND, CLOSED, config, torch.Generator().manual_seed(1))
    swapped = merge_channels(attention.flip(1), "none")
    two = select(xyz, swapped, HAND, CLOSED, config, torch.Generator().manual_seed(1))
    assert one.attention.abs().max() == 0 and not one.present.any()
    assert torch.equal(one.xyz, two.xyz)


def test_merged_channel_is_the_larger_of_both() -> None:
    _, attention = cloud()
    merged = merge_channels(attention, "merged")
    assert merged.shape == (1, 120, 1) and merged.sum() == 60


def test_centers_withstand_a_fifth_of_strays() -> None:
    xyz, attention = cloud()
    clean, _ = find_centers(xyz, attention > 0.5, 2.5)
    attention[0, :6, 0] = 0
    attention[0, 90:96, 0] = 1  # anywhere within 0.3 m
    center, kept = find_centers(xyz, attention > 0.5, 2.5)
    plain, _ = find_centers(xyz, attention > 0.5, 0.0)
    assert (center - clean)[0, 0].norm() < 0.005 < (plain - clean)[0, 0].norm()
    assert kept[0, 6:30, 0].all() and not kept[0, 90:96, 0].all()


def test_trimming_keeps_long_targets_whole() -> None:
    line = torch.zeros(1, 50, 3)
    line[0, :, 0] = torch.linspace(-0.1, 0.1, 50)
    _, kept = find_centers(line, torch.ones(1, 50, 1, dtype=torch.bool), 2.5)
    assert kept.all()


def test_strays_lose_their_attention_for_the_network_too() -> None:
    xyz, attention = cloud()
    xyz[0, 0] = torch.tensor([0.0, 0.3, 0.3])
    chosen = select(xyz, attention, HAND, CLOSED, options(crop=False))
    assert chosen.attention[0, 0, 0] == 0 and not chosen.attended[0, 0, 0]
    assert chosen.attention[0, 1:30, 0].all()


def test_farthest_points_are_the_corners_first_whatever_the_order() -> None:
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    inside = 0.4 + 0.2 * torch.rand(20, 3, generator=torch.Generator().manual_seed(0)) * 0.5
    xyz = torch.cat([inside, corners])[None]
    assert set(farthest_points(xyz, 4)[0].tolist()) == {20, 21, 22, 23}
    assert set(farthest_points(xyz.flip(1), 4)[0].tolist()) == {0, 1, 2, 3}
    assert farthest_points(xyz, 99).shape == (1, 24)


def test_neighbors_beyond_the_radius_are_replaced_by_the_nearest() -> None:
    xyz = torch.tensor([[[0.0, 0, 0], [0.01, 0, 0], [0.5, 0, 0]]])
    index = neighbors_within(xyz[:, :1], xyz, 0.02, 3)
    assert index.tolist() == [[[0, 1, 0]]]


@pytest.mark.parametrize("mode", ["separate", "merged", "none"])
def test_small_clouds_are_enough(mode: str) -> None:
    xyz, attention = cloud()
    config = options(attention_channels=mode)
    chosen = select(xyz[:, :5], merge_channels(attention[:, :5], mode), HAND, CLOSED, config)
    assert chosen.xyz.isfinite().all()


def test_tool_center_lies_below_a_hand_that_points_down() -> None:
    hand = torch.tensor([0.1, 0.2, 0.5, 1, 0, 0, 0, -1, 0, 0.04])
    expected = torch.tensor([0.1, 0.2, 0.4])
    assert torch.allclose(tool_centers(hand, 0.1), expected)
