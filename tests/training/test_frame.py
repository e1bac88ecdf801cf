from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from codediffuser.errors import ConfigError, DatasetError
from codediffuser.training.policies.attention_diffusion.frame import (
    PoseFrame,
    PoseRanges,
    measure_ranges,
    read_poses,
)


def poses(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(*shape, 10)).astype(np.float32)


def fitted(frame: str) -> PoseFrame:
    state, action = poses(1, 20), poses(2, 20)
    module = PoseFrame(frame)
    starts = np.array([0, 8, 20])
    module.set_ranges(measure_ranges(state, action, starts, frame=frame, n_obs_steps=2, horizon=4))
    return module


@pytest.mark.parametrize("frame", ["hand", "world"])
def test_decoding_undoes_encoding(frame: str) -> None:
    module, state, action = fitted(frame), poses(3, 5, 2), torch.from_numpy(poses(4, 5, 4))
    origin = module.origin(torch.from_numpy(state))
    encoded = module.encode_action(action, origin)
    assert torch.allclose(module.decode_action(encoded, origin), action, atol=1e-5)


@pytest.mark.parametrize("frame", ["hand", "world"])
def test_every_window_of_the_dataset_lies_within_minus_one_and_one(frame: str) -> None:
    state, action, module = poses(1, 20), poses(2, 20), fitted(frame)
    for first, last in ((0, 8), (8, 20)):
        for now in range(first, last):
            obs = np.clip([now - 1, now], first, last - 1)
            ahead = np.clip(np.arange(now - 1, now + 3), first, last - 1)
            window = torch.from_numpy(state[obs][None])
            origin = module.origin(window)
            assert module.encode_state(window, origin).abs().max() <= 1 + 1e-5
            scaled = module.encode_action(torch.from_numpy(action[ahead][None]), origin)
            assert scaled.abs().max() <= 1 + 1e-5


def test_hand_frame_does_not_see_where_in_the_world_it_is() -> None:
    module = fitted("hand")
    state, action = torch.from_numpy(poses(3, 1, 2)), torch.from_numpy(poses(4, 1, 4))
    shift = torch.zeros(10)
    shift[:3] = torch.tensor([1.0, -2.0, 0.5])
    here = module.encode_action(action, module.origin(state))
    there = module.encode_action(action + shift, module.origin(state + shift))
    assert torch.allclose(here, there, atol=1e-5)


def test_a_constant_dimension_is_not_stretched() -> None:
    flat = np.ones((6, 10), dtype=np.float32)
    module = PoseFrame("world")
    module.set_ranges(
        measure_ranges(flat, flat, np.array([0, 6]), frame="world", n_obs_steps=2, horizon=4)
    )
    moved = torch.from_numpy(flat[None, :4] + 0.001)
    assert module.encode_action(moved, torch.zeros(1, 3)).abs().max() < 0.01


def test_without_ranges_the_policy_says_what_to_do() -> None:
    with pytest.raises(ConfigError, match=r"train it .* or build it with dataset_meta"):
        PoseFrame("hand").check_ready()


def test_poses_are_read_from_an_export(
    toy_export: Path, toy_episodes: list[dict[str, np.ndarray]]
) -> None:
    state, action, starts = read_poses(toy_export)
    assert np.array_equal(state, np.concatenate([e["state"] for e in toy_episodes]))
    assert np.array_equal(action, np.concatenate([e["action"] for e in toy_episodes]))
    assert starts.tolist() == [24 * i for i in range(7)]


def test_a_folder_without_poses_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"meta/info.json"):
        read_poses(tmp_path)


def test_ranges_carry_their_names() -> None:
    low = np.zeros(10, dtype=np.float32)
    module = PoseFrame("hand")
    module.set_ranges(PoseRanges(low, low + 1, low + 2, low + 3))
    assert module.state_high[0] == 1 and module.action_low[0] == 2 and module.action_high[0] == 3
