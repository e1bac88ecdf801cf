"""What a checkpoint says about itself beside LeRobot's files: which clouds it was trained on."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from codediffuser.datasets.clouds import CloudConfig
from codediffuser.errors import CheckpointError
from codediffuser.schema import Document
from codediffuser.training.checkpoint import POLICY_FILE, find_model


class PolicyDocument(Document):
    """Content of `pretrained_model/codediffuser.json` (`schema: codediffuser.policy/1`)."""

    KIND: ClassVar[str] = "policy"
    VERSION: ClassVar[int] = 1

    task: str | None
    """Name of the task; None for a dataset that LeRobot's tools edited."""
    cloud: CloudConfig
    """How the clouds were made: evaluation must make the same."""
    dataset_fingerprint: str
    episodes: int
    """How many were learnt from."""
    versions: dict[str, str]
    git_commit: str


def load_policy_document(path: Path) -> PolicyDocument:
    """Read the document of a checkpoint.

    Args:
        path: See `checkpoint.find_model`.

    Raises:
        CheckpointError: There is no checkpoint, or one that stock `lerobot-train` wrote.
    """
    folder = find_model(path)
    if not (folder / POLICY_FILE).is_file():
        raise CheckpointError(
            f"{folder}: no {POLICY_FILE} here; expected a checkpoint that 'codediffuser train' "
            "wrote. For one of lerobot-train, copy the file from a checkpoint on the same dataset"
        )
    return PolicyDocument.load(folder / POLICY_FILE)
