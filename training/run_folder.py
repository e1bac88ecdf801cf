"""The folder of a training: where it lies, what it was made of, whose it is."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import ClassVar

from codediffuser.errors import ConfigError, DatasetError
from codediffuser.files import remove_partials
from codediffuser.schema import Document
from codediffuser.training.config import TrainConfig

RECORD_FILE = "train_run.json"


class TrainRecord(Document):
    """What a training was made of (`schema: codediffuser.train_run/1`)."""

    KIND: ClassVar[str] = "train_run"
    VERSION: ClassVar[int] = 1

    config: TrainConfig
    dataset_fingerprint: str
    train_episodes: tuple[str, ...]
    """Ids of the episodes that were learnt from."""
    validation_episodes: tuple[str, ...]
    versions: dict[str, str]
    git_commit: str


def dataset_root(run: Path) -> Path:
    """Find the LeRobot export of a run, or of the export's own folder.

    Raises:
        DatasetError: There is none.
    """
    for root in (run / "lerobot", run):
        if (root / "meta" / "info.json").is_file():
            return root
    raise DatasetError(
        f"{run}: no LeRobot export; expected lerobot/meta/info.json in it. "
        f"Make one with 'codediffuser convert {run}'"
    )


def output_folder(run: Path, config: TrainConfig) -> Path:
    """Where the checkpoints of a training go by default: `RUN/checkpoints/<name>`."""
    root = dataset_root(run)
    return (run if root != run else root.parent) / "checkpoints" / config.name


def claim_folder(out: Path, record: TrainRecord, *, overwrite: bool = False) -> None:
    """Make `out` this training's folder, or see that it is already.

    Args:
        out: Folder, which may not exist yet.
        record: The training.
        overwrite: Delete an earlier training there.

    Raises:
        ConfigError: It holds another training, or something else.
    """
    path = out / RECORD_FILE
    if overwrite and path.is_file():
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    remove_partials(out)
    if not path.is_file():
        if any(out.iterdir()):
            raise ConfigError(
                f"{out}: holds files of something else than a training; give another --name"
            )
        record.save(path)
        return
    earlier = TrainRecord.load(path)
    if earlier.dataset_fingerprint != record.dataset_fingerprint:
        differs = "dataset"
    elif not earlier.config.same_result(record.config):
        differs = "configuration"
    else:
        return
    raise ConfigError(
        f"{out}: belongs to a training with another {differs}; continue that one with its own, "
        "give another --name, or start anew with --overwrite"
    )
