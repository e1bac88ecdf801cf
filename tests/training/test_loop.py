from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch

from codediffuser.errors import CheckpointError, ConfigError, DatasetError, SetupError
from codediffuser.training.checkpoint import latest_checkpoint, list_checkpoints, load_policy
from codediffuser.training.config import TrainConfig
from codediffuser.training.loop import TrainProgress, train
from codediffuser.training.policy_document import load_policy_document
from codediffuser.training.training_log import read_log

Whole = tuple[Path, list[TrainProgress]]


def stop_after(run: Path, config: TrainConfig, out: Path, step: int) -> None:
    """Leave the generator in the middle, as an interrupt would."""
    for progress in train(run, config, out):
        if progress.step >= step:
            break


def weights(out: Path) -> dict[str, torch.Tensor]:
    return dict(load_policy(out)[0].state_dict())


def same_weights(one: Path, two: Path) -> bool:
    a, b = weights(one), weights(two)
    return all(torch.equal(a[key], b[key]) for key in a)


def numbers(out: Path) -> list[tuple[float, ...]]:
    """What the log says, without times."""
    keys = ("step", "loss", "lr", "val_loss", "val_error_mm")
    return [tuple(row[key] for key in keys) for row in read_log(out)]


@pytest.fixture(scope="module")
def whole(
    toy_export: Path, tiny_config: TrainConfig, tmp_path_factory: pytest.TempPathFactory
) -> Whole:
    """One uninterrupted training of 8 steps."""
    out = tmp_path_factory.mktemp("whole") / "tiny"
    return out, list(train(toy_export, tiny_config, out))


def test_progress_comes_at_its_intervals(whole: Whole) -> None:
    _, progress = whole
    assert [p.step for p in progress] == [2, 4, 6, 8]
    assert all(p.total_steps == 8 and p.steps_per_s > 0 and np.isfinite(p.loss) for p in progress)
    assert [p.checkpoint is not None for p in progress] == [False, True, False, True]
    assert [p.val_error_mm is not None for p in progress] == [False, True, False, True]
    assert progress[-1].eta_s == 0 and progress[0].eta_s > 0


def test_checkpoints_have_lerobots_form(whole: Whole) -> None:
    out, _ = whole
    assert [p.name for p in list_checkpoints(out)] == ["000004", "000008"]
    assert os.readlink(out / "last") == "000008"
    model = {p.name for p in (out / "last" / "pretrained_model").iterdir()}
    assert {"config.json", "model.safetensors"} <= model
    assert {"policy_preprocessor.json", "policy_postprocessor.json"} <= model
    state = {p.name for p in (out / "last" / "training_state").iterdir()}
    assert {"optimizer_state.safetensors", "scheduler_state.json", "training_step.json"} <= state
    assert (out / "loss.png").stat().st_size > 1000


def test_only_the_newest_checkpoints_are_kept(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    config = tiny_config.with_changes(checkpoint_every_steps=2, keep_checkpoints=1)
    list(train(toy_export, config, tmp_path / "out"))
    assert [p.name for p in list_checkpoints(tmp_path / "out")] == ["000008"]


def test_the_same_seed_gives_the_same_weights_and_another_does_not(
    toy_export: Path, tiny_config: TrainConfig, whole: Whole, tmp_path: Path
) -> None:
    torch.manual_seed(99)  # what the process did before must not matter
    list(train(toy_export, tiny_config, tmp_path / "same"))
    list(train(toy_export, tiny_config.with_changes(seed=1), tmp_path / "other"))
    assert same_weights(whole[0], tmp_path / "same")
    assert not same_weights(whole[0], tmp_path / "other")


@pytest.mark.parametrize("step", [4, 6])
def test_a_continued_training_equals_an_uninterrupted_one(
    toy_export: Path, tiny_config: TrainConfig, whole: Whole, tmp_path: Path, step: int
) -> None:
    out = tmp_path / "out"
    stop_after(toy_export, tiny_config, out, step)
    progress = list(train(toy_export, tiny_config, out))
    assert progress[0].step == 6  # both went back to checkpoint 4
    assert numbers(out) == numbers(whole[0])
    assert same_weights(out, whole[0])


def test_a_finished_training_has_nothing_left_to_do(
    toy_export: Path, tiny_config: TrainConfig, whole: Whole
) -> None:
    before = latest_checkpoint(whole[0])
    (progress,) = train(toy_export, tiny_config, whole[0])
    assert progress.step == progress.total_steps == 8
    assert latest_checkpoint(whole[0]) == before


def test_saved_weights_are_the_average(whole: Whole) -> None:
    from safetensors.torch import load_file

    raw = load_file(whole[0] / "last" / "training_state" / "raw_model.safetensors")
    saved = weights(whole[0])
    assert any(not torch.equal(raw[key], saved[key]) for key in raw)


def test_a_cap_on_time_stops_with_a_checkpoint_and_stays_stopped(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    config = tiny_config.with_changes(steps=100_000, max_minutes=1e-6)
    progress = list(train(toy_export, config, tmp_path / "out"))
    assert [p.step for p in progress] == [1] and progress[0].checkpoint is not None
    assert [p.step for p in train(toy_export, config, tmp_path / "out")] == [1]


def test_threads_of_the_process_are_put_back(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    before = torch.get_num_threads()
    list(train(toy_export, tiny_config.with_changes(steps=1, num_threads=2), tmp_path / "out"))
    assert torch.get_num_threads() == before


def test_trainings_of_other_precisions_follow_one_another_in_a_process(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    precisions: list[Literal["no", "bf16"]] = ["no", "bf16", "no"]
    for number, precision in enumerate(precisions):
        config = tiny_config.with_changes(steps=1, mixed_precision=precision)
        assert list(train(toy_export, config, tmp_path / str(number)))[-1].step == 1


def test_the_loss_falls_and_the_hand_learns_where_to_go(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    config = tiny_config.with_changes(
        steps=120, batch_size=16, validate_every_steps=10, log_every_steps=10,
        checkpoint_every_steps=120, ema={"power": 0.75, "max_decay": 0.9},
        policy={"optimizer_lr": 0.003},
    )  # fmt: skip
    progress = list(train(toy_export, config, tmp_path / "out"))
    first, last = progress[0], progress[-1]
    assert last.loss < 0.4 * first.loss
    assert first.val_error_mm is not None and last.val_error_mm is not None
    assert last.val_error_mm < 0.75 * first.val_error_mm


def test_a_checkpoint_tells_which_data_it_learnt_from(whole: Whole) -> None:
    document = load_policy_document(whole[0])
    assert document.episodes == 5 and len(document.dataset_fingerprint) == 64
    record = json.loads((whole[0] / "train_run.json").read_text())
    assert record["schema"] == "codediffuser.train_run/1"
    assert not set(record["train_episodes"]) & set(record["validation_episodes"])


def test_another_configuration_does_not_mix_with_a_training(
    toy_export: Path, tiny_config: TrainConfig, whole: Whole, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole[0], out, symlinks=True)
    other = tiny_config.with_changes(batch_size=4)
    with pytest.raises(ConfigError, match=r"another configuration.*--overwrite"):
        list(train(toy_export, other, out))
    assert [p.step for p in train(toy_export, other, out, overwrite=True)] == [2, 4, 6, 8]


def test_a_folder_of_something_else_is_left_alone(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    for overwrite in (False, True):
        with pytest.raises(ConfigError, match="something else than a training"):
            list(train(toy_export, tiny_config, tmp_path, overwrite=overwrite))
    assert (tmp_path / "thesis.tex").read_text() == "precious"


def test_default_folder_lies_in_the_run(toy_export: Path, tiny_config: TrainConfig) -> None:
    run = toy_export.parent
    list(train(run, tiny_config.with_changes(name="short", steps=1)))
    assert latest_checkpoint(run / "checkpoints" / "short") is not None


def test_a_run_without_export_says_how_to_make_one(
    tiny_config: TrainConfig, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match="codediffuser convert"):
        list(train(tmp_path, tiny_config))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_an_error_of_set_up(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    with pytest.raises(SetupError, match="--device cpu"):
        list(train(toy_export, tiny_config.with_changes(device="cuda"), tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_a_loss_that_explodes_is_told(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    config = tiny_config.with_changes(policy={"optimizer_lr": 1e30, "scheduler_warmup_steps": 0})
    with pytest.raises(ConfigError, match=r"lower policy.optimizer_lr"):
        list(train(toy_export, config, tmp_path / "out"))


def test_a_damaged_newest_checkpoint_is_told_on_continuing(
    toy_export: Path, tiny_config: TrainConfig, whole: Whole, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole[0], out, symlinks=True)
    (out / "000008" / "training_state" / "raw_model.safetensors").write_bytes(b"cut off")
    with pytest.raises(CheckpointError, match=r"000008.*delete this folder"):
        list(train(toy_export, tiny_config, out))
    shutil.rmtree(out / "000008")
    list(train(toy_export, tiny_config, out))
    assert same_weights(out, whole[0])


@pytest.mark.slow
def test_a_killed_training_goes_on(
    toy_export: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    config = tiny_config.with_changes(steps=40, checkpoint_every_steps=2, validate_every_steps=20)
    config.save(tmp_path / "train.yaml")
    code = (
        "import sys; from pathlib import Path\n"
        "from codediffuser.training.config import TrainConfig\n"
        "from codediffuser.training.loop import train\n"
        "run, config, out = map(Path, sys.argv[1:])\n"
        "for _ in train(run, TrainConfig.load(config), out): pass\n"
    )
    out = tmp_path / "out"
    arguments = [str(toy_export), str(tmp_path / "train.yaml"), str(out)]
    process = subprocess.Popen([sys.executable, "-c", code, *arguments])
    deadline = time.monotonic() + 120
    while latest_checkpoint(out) is None and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    newest = latest_checkpoint(out)
    assert newest is not None and int(newest.name) < 40
    list(train(toy_export, config, out))
    list(train(toy_export, config, tmp_path / "whole"))
    assert numbers(out) == numbers(tmp_path / "whole")
    assert same_weights(out, tmp_path / "whole")
    assert not list(out.glob(".partial-*"))
