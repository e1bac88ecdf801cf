"""Checkpoints in LeRobot's form, whole or absent: writing, finding, loading.

OUT/000500/pretrained_model/   config.json, model.safetensors, policy_preprocessor.json, ...
OUT/000500/training_state/     optimiser, schedule, step, weights before averaging
OUT/last -> 000500
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from codediffuser.errors import CheckpointError
from codediffuser.files import TEMPORARY_PREFIX, atomic_folder

if TYPE_CHECKING:
    from lerobot.processor import PolicyProcessorPipeline

    from codediffuser.training.policies.attention_diffusion.modeling_attention_diffusion import (
        AttentionDiffusionPolicy,
    )
    from codediffuser.training.policy_document import PolicyDocument
    from codediffuser.training.trainer import Trainer

MODEL_FOLDER = "pretrained_model"
STATE_FOLDER = "training_state"
LAST = "last"
POLICY_FILE = "codediffuser.json"
POLICY_TYPE = "attention_diffusion"


def list_checkpoints(out: Path) -> list[Path]:
    """All whole checkpoints of one training, oldest first."""
    if not out.is_dir():
        return []
    found = [p for p in out.iterdir() if p.name.isdigit() and (p / MODEL_FOLDER).is_dir()]
    return sorted(found, key=lambda p: int(p.name))


def latest_checkpoint(out: Path) -> Path | None:
    """The newest whole checkpoint, or None. The link `last` may be one behind after a kill."""
    found = list_checkpoints(out)
    return found[-1] if found else None


def save_checkpoint(out: Path, trainer: Trainer, document: PolicyDocument, keep: int) -> Path:
    """Write the trainer's state under its step number, then delete all but the `keep` newest.

    Args:
        out: Folder of the training.
        trainer: What to save.
        document: What the checkpoint says about itself.
        keep: How many checkpoints to keep.

    Returns:
        The checkpoint's folder.
    """
    target = out / f"{trainer.step:06d}"
    with atomic_folder(target) as partial:
        trainer.save(partial / MODEL_FOLDER, partial / STATE_FOLDER)
        document.save(partial / MODEL_FOLDER / POLICY_FILE)
    link = out / f"{TEMPORARY_PREFIX}{os.getpid()}-{LAST}"
    link.unlink(missing_ok=True)
    link.symlink_to(target.name)
    os.replace(link, out / LAST)
    for old in list_checkpoints(out)[:-keep]:
        shutil.rmtree(old)
    return target


def find_model(path: Path) -> Path:
    """Return the `pretrained_model` folder that a path means.

    Args:
        path: Such a folder, a checkpoint, `last`, or the folder of a training (its newest).

    Raises:
        CheckpointError: There is none.
    """
    for folder in (path, path / MODEL_FOLDER, (latest_checkpoint(path) or path) / MODEL_FOLDER):
        if (folder / "config.json").is_file():
            return folder
    raise CheckpointError(
        f"{path}: no checkpoint here; expected {MODEL_FOLDER}/config.json in it or in a numbered "
        "folder. Train one with 'codediffuser train RUN' or give another path"
    )


def load_policy(
    path: Path, device: str = "cpu"
) -> tuple[
    AttentionDiffusionPolicy,
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[Any, Any],
]:
    """Load a policy for evaluation with the processors saved beside it.

    Args:
        path: See `find_model`.
        device: Torch device to run on.

    Raises:
        CheckpointError: Missing, damaged, or of another policy.
    """
    from safetensors import SafetensorError

    folder = find_model(Path(path))
    kind = _policy_type(folder)
    if kind != POLICY_TYPE:
        raise CheckpointError(
            f"{folder}: expected a checkpoint of policy '{POLICY_TYPE}', got '{kind}'; "
            "evaluate other policies with LeRobot's own tools"
        )
    try:
        return _load(folder, device)
    except (OSError, SafetensorError, RuntimeError, ValueError, KeyError) as error:
        line = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise CheckpointError(
            f"{folder}: damaged or incompatible checkpoint: {line}; use an older checkpoint or "
            "train again"
        ) from None


def _policy_type(folder: Path) -> str:
    try:
        raw = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        return str(raw["type"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{folder}/config.json: not a LeRobot policy: {error!r}") from None


def _load(folder: Path, device: str) -> Any:
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import make_pre_post_processors
    from safetensors.torch import load_model

    from codediffuser.training.policies.attention_diffusion import (
        modeling_attention_diffusion as modeling,
    )
    from codediffuser.training.policies.attention_diffusion import (
        processor_attention_diffusion,  # noqa: F401  registers the steps that the files name
    )

    config = PreTrainedConfig.from_pretrained(folder)
    config.device = device
    policy = modeling.AttentionDiffusionPolicy(config)
    load_model(policy, str(folder / "model.safetensors"), strict=True, device=device)
    policy.frame.check_ready()
    before, after = make_pre_post_processors(
        config,
        pretrained_path=str(folder),
        preprocessor_overrides={"device_processor": {"device": device}},
    )
    return policy.to(device).eval(), before, after
