from __future__ import annotations

import pytest
import torch

from codediffuser.training.augment import Augmentation, augment_clouds, displace_hand

OFF = Augmentation(0.0, 0.0, 0.0, 0.0, 0.0)
SWAP = Augmentation(1.0, 0.2, 0.0, 0.0, 0.0)


def clouds(batch: int = 64) -> torch.Tensor:
    """(B, 2, 400, 5), a quarter attended per channel, in a 5 cm clump each."""
    torch.manual_seed(0)
    points = torch.zeros(batch, 2, 400, 5)
    points[..., :3] = torch.rand(batch, 2, 400, 3) * 0.4
    for channel in range(2):
        rows = slice(100 * channel, 100 * channel + 100)
        points[:, :, rows, :3] = 0.05 * torch.rand(batch, 2, 100, 3) + 0.2 * channel
        points[:, :, rows, 3 + channel] = 1
    return points


def test_nothing_asked_changes_nothing() -> None:
    before = clouds()
    assert torch.equal(augment_clouds(before, OFF), before)


def test_swaps_move_attention_but_keep_its_amount() -> None:
    before = clouds()
    after = augment_clouds(before, SWAP)
    assert torch.equal(after[..., :3], before[..., :3])
    lost = ((before[..., 3:] == 1) & (after[..., 3:] == 0)).sum(dim=2) / 100
    gained = ((before[..., 3:] == 0) & (after[..., 3:] == 1)).sum(dim=2) / 100
    assert 0.08 < lost.mean() < 0.12 and lost.max() < 0.4
    assert abs(lost.mean() - gained.mean()) < 0.02


def test_some_swaps_stay_near_the_target() -> None:
    before = clouds()
    after = augment_clouds(before, SWAP)
    gained = (before[..., 3] == 0) & (after[..., 3] == 1)
    center = before[:, :, :100, :3].mean(dim=2, keepdim=True)
    near = (before[..., :3] - center).norm(dim=-1) < 0.1
    others = before[..., 3] == 0
    share_of_gained = (gained & near).sum() / gained.sum()
    share_of_others = (others & near).sum() / others.sum()
    assert share_of_gained > 2 * share_of_others


def test_probability_is_the_share_of_samples() -> None:
    before = clouds(300)
    after = augment_clouds(before, Augmentation(0.3, 0.2, 0.0, 0.0, 0.0))
    touched = (after != before).flatten(1).any(dim=1).float().mean()
    assert 0.2 < touched < 0.4


def test_drops_only_take_attention_away() -> None:
    before = clouds()
    after = augment_clouds(before, Augmentation(0.0, 0.0, 1.0, 0.5, 0.0))
    assert (after[..., 3:] <= before[..., 3:]).all()
    assert 0.7 < after[..., 3:].sum() / before[..., 3:].sum() < 0.8


def test_noise_has_the_asked_size() -> None:
    before = clouds()
    after = augment_clouds(before, Augmentation(0.0, 0.0, 0.0, 0.0, 0.002))
    assert abs(float((after - before)[..., :3].std()) - 0.002) < 1e-4


def test_clouds_without_attention_stay_without() -> None:
    before = clouds()
    before[..., 3:] = 0
    assert augment_clouds(before, SWAP)[..., 3:].abs().max() == 0


def displaced(opening: float) -> tuple[torch.Tensor, torch.Tensor]:
    """How clouds (B, 3) and actions (B, 3) of open or closed hands moved."""
    before, actions = clouds(200), torch.zeros(200, 16, 10)
    torch.manual_seed(1)
    after, moved = displace_hand(
        before, actions, torch.full((200,), opening), probability=0.5, size_m=0.01
    )
    scene = (after - before)[..., :3]
    assert torch.allclose(scene, scene[:, :1, :1].expand_as(scene), atol=1e-6)
    assert torch.equal(after[..., 3:], before[..., 3:])
    assert moved[..., 3:].abs().max() == 0
    return scene[:, 0, 0], moved[:, 0, :3]


def test_an_open_hand_that_is_off_goes_to_the_same_places_in_the_world() -> None:
    scene, actions = displaced(opening=1.0)
    assert torch.allclose(scene, actions, atol=1e-6)
    assert 0.4 < (scene.norm(dim=-1) > 0).float().mean() < 0.6
    assert 0.008 < scene[scene.norm(dim=-1) > 0].std() < 0.012


@pytest.mark.parametrize("opening", [-1.0, 0.3])
def test_a_hand_that_holds_something_or_moves_its_fingers_is_left_alone(opening: float) -> None:
    scene, actions = displaced(opening)
    assert scene.abs().max() == 0 and actions.abs().max() == 0
