from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import torch

from codediffuser.datasets.features import POINTS, STATE
from codediffuser.errors import CheckpointError
from codediffuser.training.checkpoint import find_model, load_policy
from codediffuser.training.config import TrainConfig
from codediffuser.training.loop import train
from codediffuser.training.policy_document import load_policy_document


@pytest.fixture(scope="module")
def trained(
    toy_export: Path, tiny_config: TrainConfig, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    out = tmp_path_factory.mktemp("trained") / "tiny"
    list(train(toy_export, tiny_config.with_changes(steps=2), out))
    return out


@pytest.fixture
def model(trained: Path, tmp_path: Path) -> Path:
    """A copy of a `pretrained_model` folder, to be damaged."""
    return Path(shutil.copytree(find_model(trained), tmp_path / "model"))


def test_every_way_to_name_a_checkpoint_finds_it(trained: Path) -> None:
    places = ("", "last", "000002", "last/pretrained_model", "000002/pretrained_model")
    assert {find_model(trained / place).resolve() for place in places} == {
        (trained / "000002" / "pretrained_model").resolve()
    }


def test_a_loaded_policy_acts(trained: Path) -> None:
    policy, before, after = load_policy(trained)
    policy.reset(seed=1)
    batch = before({POINTS: torch.rand(1, 480), STATE: torch.rand(1, 10)})
    action = after(policy.select_action(batch))
    assert action.shape == (1, 10) and action.isfinite().all() and not policy.training


def test_lerobots_own_loader_gives_the_same_policy(trained: Path) -> None:
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class

    ours, _, _ = load_policy(trained)
    folder = find_model(trained)
    config = PreTrainedConfig.from_pretrained(folder)
    theirs = get_policy_class(config.type).from_pretrained(folder, config=config)
    assert all(
        torch.equal(value, theirs.state_dict()[key]) for key, value in ours.state_dict().items()
    )


def test_no_checkpoint_at_all(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"no checkpoint here.*codediffuser train"):
        load_policy(tmp_path / "nowhere")


def test_a_checkpoint_of_another_policy_is_refused_by_name(model: Path) -> None:
    config = json.loads((model / "config.json").read_text())
    (model / "config.json").write_text(json.dumps(config | {"type": "act"}))
    with pytest.raises(CheckpointError, match=r"expected .* 'attention_diffusion', got 'act'"):
        load_policy(model)


def test_cut_off_weights_are_told(model: Path) -> None:
    data = (model / "model.safetensors").read_bytes()
    (model / "model.safetensors").write_bytes(data[: len(data) // 2])
    with pytest.raises(CheckpointError, match="damaged or incompatible"):
        load_policy(model)


def test_weights_of_another_shape_are_told(model: Path) -> None:
    config = json.loads((model / "config.json").read_text())
    (model / "config.json").write_text(json.dumps(config | {"encoder_dim": 8}))
    with pytest.raises(CheckpointError, match="damaged or incompatible"):
        load_policy(model)


@pytest.mark.parametrize("text", ["{", "[]", '{"no": "type"}'])
def test_a_config_that_is_none_is_told(model: Path, text: str) -> None:
    (model / "config.json").write_text(text)
    with pytest.raises(CheckpointError, match="not a LeRobot policy"):
        load_policy(model)


@pytest.mark.parametrize("name", ["model.safetensors", "policy_preprocessor.json"])
def test_a_missing_file_is_told(model: Path, name: str) -> None:
    (model / name).unlink()
    with pytest.raises(CheckpointError, match="damaged or incompatible"):
        load_policy(model)


def test_a_checkpoint_of_stock_lerobot_train_has_no_document(model: Path) -> None:
    (model / "codediffuser.json").unlink()
    with pytest.raises(CheckpointError, match="'codediffuser train' wrote"):
        load_policy_document(model)
