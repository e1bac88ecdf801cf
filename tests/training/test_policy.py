from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from codediffuser.datasets.features import ACTION, POINTS, STATE
from codediffuser.errors import ConfigError, ShapeError
from codediffuser.training.build import policy_config
from codediffuser.training.policies.attention_diffusion import (
    modeling_attention_diffusion as modeling,
)
from codediffuser.training.policies.attention_diffusion.frame import measure_ranges
from codediffuser.training.policies.attention_diffusion.modeling_attention_diffusion import (
    AttentionDiffusionPolicy,
)
from codediffuser.training.policies.attention_diffusion.processor_attention_diffusion import (
    make_attention_diffusion_pre_post_processors,
)

Episodes = list[dict[str, np.ndarray]]
TINY = {
    "type": "attention_diffusion", "down_dims": [16, 32], "encoder_dim": 16,
    "crop_pick_points": 8, "crop_place_points": 8, "crop_hand_points": 8, "num_inference_steps": 3,
}  # fmt: skip


def make_policy(episodes: Episodes, **changes: object) -> AttentionDiffusionPolicy:
    points = episodes[0]["points"]
    config = policy_config(TINY | changes, points[0].size, "cpu")
    state, action = (np.concatenate([e[key] for e in episodes]) for key in ("state", "action"))
    ranges = measure_ranges(
        state, action, np.arange(len(episodes) + 1) * len(points),
        frame=config.frame, n_obs_steps=config.n_obs_steps, horizon=config.horizon,
    )  # fmt: skip
    torch.manual_seed(0)
    return AttentionDiffusionPolicy(config, ranges=ranges)


def window(episodes: Episodes, batch_size: int = 3) -> dict[str, Tensor]:
    chosen = episodes[:batch_size]
    return {
        POINTS: torch.from_numpy(np.stack([e["points"][4:6].reshape(2, -1) for e in chosen])),
        STATE: torch.from_numpy(np.stack([e["state"][4:6] for e in chosen])),
        ACTION: torch.from_numpy(np.stack([e["action"][4:20] for e in chosen])),
        "action_is_pad": torch.zeros(len(chosen), 16, dtype=torch.bool),
    }


def shifted(batch: dict[str, Tensor], offset: Tensor) -> dict[str, Tensor]:
    """The same scene elsewhere in the world."""
    moved = {key: value.clone() for key, value in batch.items()}
    moved[POINTS].unflatten(-1, (-1, 5))[..., :3] += offset
    moved[STATE][..., :3] += offset
    moved[ACTION][..., :3] += offset
    return moved


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"attention_channels": "merged"},
        {"attention_channels": "none"},
        {"crop": False, "encoder": "pointnet2", "frame": "world"},
        {"use_proprioception": False, "use_centroids": False, "prediction_type": "epsilon"},
        {"noise_draws": 4, "mask_padded_actions": True, "inference_scheduler": "DDPM"},
    ],
)
def test_every_switch_trains_and_acts(toy_episodes: Episodes, changes: dict[str, object]) -> None:
    policy, batch = make_policy(toy_episodes, **changes), window(toy_episodes)
    loss, _ = policy.train()(batch)
    loss.backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in policy.parameters())
    chunk = policy.eval().predict_action_chunk(batch)
    assert chunk.shape == (3, 8, 10) and chunk.isfinite().all()


def test_half_precision_gives_nearly_the_same_loss(toy_episodes: Episodes) -> None:
    policy, batch = make_policy(toy_episodes).eval(), window(toy_episodes)
    losses = []
    for enabled in (False, True):
        torch.manual_seed(1)
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            losses.append(float(policy(batch)[0]))
    assert losses[0] != losses[1] and abs(losses[0] - losses[1]) < 0.05 * losses[0]


def test_actions_move_with_the_world(toy_episodes: Episodes) -> None:
    policy, batch = make_policy(toy_episodes).eval(), window(toy_episodes)
    offset, noise = torch.tensor([0.5, -0.3, 0.2]), torch.randn(3, 16, 10)
    policy.reset(seed=1)
    here = policy.predict_action_chunk(batch, noise=noise)
    policy.reset(seed=1)
    there = policy.predict_action_chunk(shifted(batch, offset), noise=noise)
    assert torch.allclose(here[..., :3] + offset, there[..., :3], atol=1e-4)
    assert torch.allclose(here[..., 3:], there[..., 3:], atol=1e-4)


def test_attention_decides_the_actions(toy_episodes: Episodes) -> None:
    policy, batch = make_policy(toy_episodes).eval(), window(toy_episodes)
    noise = torch.randn(3, 16, 10)
    policy.reset(seed=1)
    one = policy.predict_action_chunk(batch, noise=noise)
    exchanged = batch[POINTS].unflatten(-1, (-1, 5))[..., [0, 1, 2, 4, 3]].flatten(-2)
    policy.reset(seed=1)
    two = policy.predict_action_chunk(batch | {POINTS: exchanged}, noise=noise)
    assert (one - two).abs().max() > 1e-4


def test_ablation_none_ignores_attention(toy_episodes: Episodes) -> None:
    policy = make_policy(toy_episodes, attention_channels="none").eval()
    batch, noise = window(toy_episodes), torch.randn(3, 16, 10)
    wiped = batch[POINTS].unflatten(-1, (-1, 5)).clone()
    wiped[..., 3:] = 0
    policy.reset(seed=1)
    one = policy.predict_action_chunk(batch, noise=noise)
    policy.reset(seed=1)
    two = policy.predict_action_chunk(batch | {POINTS: wiped.flatten(-2)}, noise=noise)
    assert torch.equal(one, two)


def observation(episodes: Episodes, t: int) -> dict[str, Tensor]:
    return {
        POINTS: torch.from_numpy(episodes[0]["points"][t].reshape(1, -1)),
        STATE: torch.from_numpy(episodes[0]["state"][t][None]),
    }


def test_same_seed_and_observations_give_the_same_actions(toy_episodes: Episodes) -> None:
    policy = make_policy(toy_episodes).eval()
    runs = []
    for seed in (5, 5, 6):
        policy.reset(seed=seed)
        torch.rand(3)  # what else happens in the process must not matter
        runs.append(
            torch.cat([policy.select_action(observation(toy_episodes, t)) for t in range(20)])
        )
    assert torch.equal(runs[0], runs[1]) and not torch.equal(runs[0], runs[2])


def test_observations_that_no_plan_reads_may_be_left_out(toy_episodes: Episodes) -> None:
    policy = make_policy(toy_episodes).eval()
    policy.reset(seed=5)
    full = [policy.select_action(observation(toy_episodes, t)) for t in range(20)]
    policy.reset(seed=5)
    lean, used = [], 0
    for t in range(20):
        used += policy.needs_observation
        given = observation(toy_episodes, t) if policy.needs_observation else {}
        lean.append(policy.select_action(given))
    assert torch.equal(torch.cat(full), torch.cat(lean))
    assert used == 5  # step 0, and two for each later plan: 7 and 8, 15 and 16


def test_a_plan_begins_with_the_present_step(toy_episodes: Episodes) -> None:
    # A denoiser that answers with the number of the predicted step shows which ones are taken.
    policy = make_policy(toy_episodes, n_action_steps=5).eval()
    index = torch.arange(16.0)[None, :, None].expand(1, 16, 10)
    policy.diffusion.sample = lambda *_: index  # type: ignore[method-assign]
    policy.frame.decode_action = lambda action, _: action  # type: ignore[method-assign]
    chunk = policy.predict_action_chunk(observation(toy_episodes, 0))
    assert chunk[0, :, 0].tolist() == [1, 2, 3, 4, 5]  # 0 belongs to the older observation


def test_clouds_are_damaged_in_training_alone(
    toy_episodes: Episodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, batch, calls = make_policy(toy_episodes), window(toy_episodes), []

    def damage(clouds: Tensor, _: object) -> Tensor:
        calls.append(len(clouds))
        return clouds

    monkeypatch.setattr(modeling, "augment_clouds", damage)
    policy.train()(batch)
    policy.eval()(batch)
    assert calls == [3]


def test_padded_actions_can_be_left_out_of_the_loss(toy_episodes: Episodes) -> None:
    policy = make_policy(toy_episodes, mask_padded_actions=True).eval()
    batch = window(toy_episodes)
    batch["action_is_pad"][:, 10:] = True
    torch.manual_seed(1)
    loss, _ = policy(batch)
    batch["action_is_pad"][:] = True
    torch.manual_seed(1)
    nothing, _ = policy(batch)
    assert loss > 0 and nothing == 0


def test_processors_take_every_shape_an_observation_comes_in(toy_episodes: Episodes) -> None:
    policy = make_policy(toy_episodes).eval()
    before, after = make_attention_diffusion_pre_post_processors(policy.config)
    points, state = toy_episodes[0]["points"][0], toy_episodes[0]["state"][0]
    flat = torch.from_numpy(points.reshape(1, -1))
    for given in (
        {POINTS: flat, STATE: torch.from_numpy(state[None])},
        {POINTS: torch.from_numpy(points[None]), STATE: torch.from_numpy(state[None])},
        {POINTS: torch.from_numpy(points), STATE: torch.from_numpy(state)},
        {POINTS: flat[0], STATE: torch.from_numpy(state)},
        {"observation.robot_state": {"points": points[None], "state": state[None]}},
        {"observation.robot_state": {"points": flat}, STATE: torch.from_numpy(state[None])},
    ):
        batch = before(dict(given))
        assert torch.equal(batch[POINTS], flat) and batch[STATE].shape == (1, 10)
        assert after(policy.select_action(batch)).shape == (1, 10)


def test_windows_pass_the_processors_unchanged(toy_episodes: Episodes) -> None:
    policy, batch = make_policy(toy_episodes), window(toy_episodes)
    before, _ = make_attention_diffusion_pre_post_processors(policy.config)
    done = before(dict(batch))
    assert all(torch.equal(done[key], batch[key]) for key in batch)


def test_dataset_meta_gives_the_same_ranges_as_the_arrays(
    toy_episodes: Episodes, toy_export: Path
) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata

    by_arrays = make_policy(toy_episodes)
    meta = LeRobotDatasetMetadata("toy/points", root=toy_export)
    by_meta = AttentionDiffusionPolicy(by_arrays.config, dataset_meta=meta)
    for name, buffer in by_arrays.frame.named_buffers():
        assert torch.allclose(buffer, dict(by_meta.frame.named_buffers())[name])


def test_without_ranges_nothing_is_predicted(toy_episodes: Episodes) -> None:
    policy = AttentionDiffusionPolicy(policy_config(TINY, 480, "cpu")).eval()
    with pytest.raises(ConfigError, match="no action ranges"):
        policy.predict_action_chunk(window(toy_episodes))


def test_a_cloud_of_another_width_is_refused(toy_episodes: Episodes) -> None:
    policy, batch = make_policy(toy_episodes), window(toy_episodes)
    with pytest.raises(ShapeError, match=r"expected \(B, To, N\*5\)"):
        policy(batch | {POINTS: batch[POINTS][..., :-1]})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame": "hnad"}, "Did you mean 'hand'"),
        ({"horizonn": 16}, "Did you mean 'horizon'"),
        ({"horizon": 15}, "multiple of 4"),
        ({"n_action_steps": 16}, "at most horizon - n_obs_steps"),
        ({"noise_draws": "many"}, "noise_draws"),
        ({"type": "act"}, "Unknown policy.type 'act'"),
    ],
)
def test_wrong_options_are_named(
    toy_episodes: Episodes, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        make_policy(toy_episodes, **changes)


def test_features_of_another_dataset_are_refused() -> None:
    with pytest.raises(ConfigError, match="convert --profile pointcloud"):
        policy_config(TINY, 481, "cpu").validate_features()
