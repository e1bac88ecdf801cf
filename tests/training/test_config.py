from __future__ import annotations

from pathlib import Path

import pytest

from codediffuser.errors import ConfigError, SchemaVersionError
from codediffuser.training.build import policy_config
from codediffuser.training.config import TrainConfig, load_preset, preset_names


@pytest.mark.parametrize("name", ["cpu", "paper"])
def test_every_option_of_a_preset_is_known_to_its_policy(name: str) -> None:
    assert policy_config(load_preset(name).policy, 2560, "cpu").type == "attention_diffusion"


def test_these_are_the_presets() -> None:
    assert preset_names() == ["cpu", "paper"]


def test_cpu_preset_is_the_default_of_the_policy() -> None:
    # Stock `lerobot-train --policy.type=attention_diffusion` then trains the same network.
    bare = policy_config({"type": "attention_diffusion"}, 2560, "cpu")
    assert policy_config(load_preset("cpu").policy, 2560, "cpu") == bare


def test_paper_preset_has_the_numbers_of_the_paper() -> None:
    config = load_preset("paper")
    policy = policy_config(config.policy, 8000, "cpu")
    assert policy.down_dims == (512, 1024, 2048) and policy.encoder == "pointnet2"
    assert policy.prediction_type == "epsilon" and policy.num_inference_steps == 100
    optimizer = policy.get_optimizer_preset()
    assert (optimizer.lr, optimizer.betas, optimizer.weight_decay) == (1e-4, (0.95, 0.999), 1e-6)
    assert policy.get_scheduler_preset().num_warmup_steps == 2000
    assert config.planned_steps(num_frames=6400) == (36_000, 60_000)


def test_more_processes_need_fewer_steps_per_epoch() -> None:
    assert load_preset("paper").planned_steps(6400, num_processes=4) == (9_000, 15_000)


def test_a_config_survives_its_file(tmp_path: Path) -> None:
    config = load_preset("paper").with_changes(seed=3)
    config.save(tmp_path / "mine.yaml")
    assert load_preset(str(tmp_path / "mine.yaml")) == config


def test_changes_merge_into_the_policy() -> None:
    config = load_preset("cpu").with_changes(steps=7, policy={"attention_channels": "none"})
    assert config.steps == 7 and config.policy["attention_channels"] == "none"
    assert config.policy["down_dims"] == [64, 128]
    assert load_preset("cpu").policy["attention_channels"] == "separate"


def test_steps_replace_epochs_and_the_other_way_round() -> None:
    assert load_preset("paper").with_changes(steps=9).planned_steps(6400) == (9, 9)
    assert load_preset("cpu").with_changes(epochs=2).planned_steps(640) == (20, 20)


def test_what_changes_no_weight_may_differ_on_continuing() -> None:
    config = load_preset("cpu")
    assert config.same_result(config.with_changes(num_threads=2, max_minutes=5, keep_checkpoints=9))
    assert not config.same_result(config.with_changes(seed=1))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": 3}, "did you mean 'steps'"),
        ({"batch_size": 0}, "batch_size"),
        ({"device": "tpu"}, "device"),
        ({"ema": {"decay": 0.9}}, "decay"),
    ],
)
def test_wrong_entries_are_named(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_preset("cpu").with_changes(**changes)


def test_a_length_is_needed() -> None:
    with pytest.raises(ConfigError, match="either 'steps' or 'epochs'"):
        TrainConfig.parse({"schema": "codediffuser.train/1", "name": "x", "policy": {}}, "x.yaml")


def test_unknown_preset_names_the_closest() -> None:
    with pytest.raises(ConfigError, match="Did you mean 'paper'"):
        load_preset("papre")


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "task.yaml").write_text("schema: codediffuser.task/1\n")
    with pytest.raises(SchemaVersionError, match=r"codediffuser.train/1"):
        load_preset(str(tmp_path / "task.yaml"))
