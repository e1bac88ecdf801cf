"""Stock LeRobot programs with our policy, found through the installed plugin distribution."""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path

import pytest
import torch

from codediffuser.training.checkpoint import find_model, load_policy

PLUGIN = "lerobot_policy_codediffuser"


def test_the_plugin_has_the_name_that_lerobot_looks_for() -> None:
    # Hyphens instead of underscores would be passed over without a word.
    assert importlib.metadata.metadata(PLUGIN)["Name"] == PLUGIN


def test_the_plugin_registers_policy_and_environment() -> None:
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.envs.configs import EnvConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    assert PLUGIN in sys.modules
    assert "attention_diffusion" in PreTrainedConfig.get_known_choices()
    assert "codediffuser" in EnvConfig.get_known_choices()


def run_lerobot_train(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    from lerobot.scripts import lerobot_train

    common = ["--policy.device=cpu", "--policy.push_to_hub=false", "--batch_size=4"]
    common += ["--num_workers=0", "--steps=2", "--save_freq=2", "--eval_freq=0", "--log_freq=1"]
    monkeypatch.setattr(sys, "argv", ["lerobot-train", *common, *arguments])
    lerobot_train.main()


@pytest.mark.slow
def test_stock_lerobot_train_trains_it_and_goes_on_from_our_checkpoint(
    toy_export: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = ["--dataset.repo_id=toy/points", f"--dataset.root={toy_export}"]
    small = ["--policy.type=attention_diffusion", "--policy.down_dims=[16,32]"]
    small += ["--policy.num_inference_steps=3"]
    run_lerobot_train(monkeypatch, *dataset, *small, f"--output_dir={tmp_path / 'first'}")
    policy, _, _ = load_policy(tmp_path / "first" / "checkpoints")
    assert policy.config.down_dims == (16, 32)
    assert not any(buffer.isnan().any() for buffer in policy.frame.buffers())

    again = [f"--policy.path={find_model(tmp_path / 'first' / 'checkpoints')}"]
    run_lerobot_train(monkeypatch, *dataset, *again, f"--output_dir={tmp_path / 'second'}")
    finer, _, _ = load_policy(tmp_path / "second" / "checkpoints")
    old, new = policy.state_dict(), finer.state_dict()
    assert torch.equal(old["frame.action_low"], new["frame.action_low"])
    assert not torch.equal(old["encoder.head.weight"], new["encoder.head.weight"])


@pytest.mark.slow
@pytest.mark.sim
def test_stock_lerobot_eval_runs_a_checkpoint_in_our_environment(
    toy_export: Path, tiny_config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import gymnasium as gym
    from lerobot.scripts import lerobot_eval

    from codediffuser.training.loop import train

    list(train(toy_export, tiny_config.with_changes(steps=1), tmp_path / "out"))
    make = gym.make

    def make_short(*arguments: object, **options: object) -> gym.Env:
        env = make(*arguments, **options)
        env.unwrapped._max_episode_steps = 3
        return env

    monkeypatch.setattr(gym, "make", make_short)
    arguments = [
        f"--policy.path={find_model(tmp_path / 'out')}", "--policy.device=cpu",
        "--env.type=codediffuser", "--env.width=64", "--env.height=48",
        "--eval.batch_size=1", "--eval.n_episodes=1", f"--output_dir={tmp_path / 'eval'}",
    ]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", *arguments])
    lerobot_eval.main()
    assert (tmp_path / "eval" / "eval_info.json").is_file()
    assert list((tmp_path / "eval").rglob("*.mp4"))
