"""What an export says about itself beside LeRobot's files: `meta/codediffuser.json`.

LeRobot's loader ignores the file and its edit tools do not copy it: a dataset that they made has
none, and is known by `dataset_fingerprint` alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field

from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.features import POINTS
from codediffuser.errors import DatasetError
from codediffuser.files import sha256_file, sha256_json
from codediffuser.schema import Document, Raw, Strict, parse_model

DOCUMENT = "meta/codediffuser.json"
INFO = "meta/info.json"
CARD = "README.md"
CARD_ASSETS = "card"
"""Folder of the card's pictures."""
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
PART_STATS = "meta/codediffuser_stats"
"""Folder with one `PartStats` file per episode: what merging needs for exact quantiles."""
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
CODEBASE_VERSION = "v3.0"
"""LeRobot's name of the layout."""


OTHER_DOCUMENT = "codediffuser.json"
"""The same document in exports of other formats."""


class ExportedEpisode(Strict):
    """Where one episode of the export came from."""

    episode_index: int
    episode_id: str
    frames: int
    episode_sha256: str
    """Content of the episode, as labels name it."""
    labels_revision: int
    """0 for an episode without labels."""
    labels_sha256: str
    """SHA-256 of what the labels say, which names points by hash; empty without labels."""
    part: str = ""
    """`part_key`: hash of all that decided what the export holds of this episode."""


class DatasetDocument(Document):
    """What `meta/codediffuser.json` says (`schema: codediffuser.dataset/2`).

    Version 2 adds `format`, `options` and each episode's `part`; `cloud` may be absent.
    """

    KIND: ClassVar[str] = "dataset"
    VERSION: ClassVar[int] = 2
    UPGRADES: ClassVar[dict[int, Callable[[Raw], Raw]]] = {1: dict}  # all that is new has defaults

    format: str = "lerobot"
    profile: str
    options: dict[str, Any] = Field(default_factory=dict)
    """What of the options decided the bytes."""
    task: str
    """Name of the task, or of all tasks, joined by commas."""
    cloud: CloudConfig | None = None
    """How clouds were made; None for profiles without."""
    source: str
    """Name of the run folder."""
    episodes: tuple[ExportedEpisode, ...]
    left_out: tuple[str, ...]
    """Ids of episodes that did not succeed."""
    rejected: tuple[str, ...] = ()
    """Ids of episodes that were left out since a reviewer rejected their labels."""
    with_rejected: bool = False
    """Whether such episodes were exported instead."""
    versions: dict[str, str]
    git_commit: str
    content_sha256: str
    """`dataset_fingerprint` of the export when it was written."""


def dataset_fingerprint(root: Path) -> str:
    """SHA-256 over names and bytes of `data/`, `meta/` and `videos/`, without our own document.

    Raises:
        DatasetError: There is no LeRobot dataset at `root`.
    """
    load_info(root)
    files = [p for part in ("data", "meta", "videos") for p in (root / part).rglob("*")]
    return _hash_files(root, [p for p in files if p != root / DOCUMENT])


def export_fingerprint(root: Path) -> str:
    """`dataset_fingerprint` for an export of another format: all its files count, save the card."""
    apart = {OTHER_DOCUMENT, CARD, CARD_ASSETS}
    return _hash_files(
        root, [p for p in root.rglob("*") if p.relative_to(root).parts[0] not in apart]
    )


def _hash_files(root: Path, files: Iterable[Path]) -> str:
    return sha256_json(
        {p.relative_to(root).as_posix(): sha256_file(p) for p in files if p.is_file()}
    )


def load_dataset_document(root: Path) -> DatasetDocument:
    """Read `meta/codediffuser.json`.

    Raises:
        DatasetError: It is missing or damaged, or there is no dataset.
        SchemaVersionError: It is of a version that this code cannot read.
    """
    load_info(root)
    path = root / DOCUMENT
    if not path.exists():
        raise DatasetError(
            f"{path}: no such file; expected a dataset that `codediffuser convert` wrote "
            "(LeRobot's edit tools drop this file: copy it from their source)"
        )
    return DatasetDocument.load(path)


def load_info(root: Path) -> dict[str, Any]:
    """Read `meta/info.json` of a LeRobot dataset and check its layout.

    Raises:
        DatasetError: The file is missing or damaged, or names another layout than v3.0.
    """
    path = root / INFO
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise DatasetError(
            f"{root}: no LeRobot dataset here, {INFO} is missing; run `codediffuser convert RUN`"
        ) from None
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: not readable as JSON: {error}") from None
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise DatasetError(f"{path}: expected a mapping with 'features'; is it a LeRobot dataset?")
    version = info.get("codebase_version")
    if version != CODEBASE_VERSION:
        raise DatasetError(
            f"{path}: expected codebase_version '{CODEBASE_VERSION}', got '{version}'; convert the "
            "dataset with LeRobot's own tool, or run `codediffuser convert RUN` again"
        )
    return info


def cloud_config(root: Path) -> CloudConfig:
    """How the clouds of a dataset were made; LeRobot's edit tools keep this.

    Raises:
        DatasetError: There is no dataset, or not one of the `pointcloud` profile.
    """
    names = load_info(root)["features"].get(POINTS, {}).get("names")
    if not isinstance(names, dict) or "cloud" not in names:
        raise DatasetError(
            f"{root / INFO}: the names of '{POINTS}' do not say how clouds were made; expected a "
            "dataset that `codediffuser convert` wrote, or one that was edited from it"
        )
    return parse_model(CloudConfig, names["cloud"], f"{root / INFO}: features.{POINTS}.names.cloud")


def require_features(root: Path, info: dict[str, Any], expected: dict[str, str]) -> None:
    """Check that features exist with the expected dtype.

    Raises:
        DatasetError: A feature is missing or has another dtype.
    """
    for key, dtype in expected.items():
        found = info["features"].get(key, {}).get("dtype")
        if found != dtype:
            raise DatasetError(
                f"{root / INFO}: expected feature '{key}' of dtype {dtype}, got "
                f"{found or 'none'}; features are: {', '.join(sorted(info['features']))}"
            )


def find_document(root: Path) -> DatasetDocument | None:
    """The document, or None for a dataset that LeRobot's tools made.

    Raises:
        DatasetError: There is no dataset.
        SchemaVersionError: The document is of a version that this code cannot read.
    """
    load_info(root)
    return load_dataset_document(root) if (root / DOCUMENT).exists() else None


def content_hashes(root: Path, without: Collection[str] = ()) -> dict[str, str]:
    """Hashes of all files of an export by their paths; our document's is that of its content.

    Args:
        root: Folder of the export, or of several.
        without: Names of files to leave out, such as the card, which quotes the commit.
    """
    return {
        path.relative_to(root).as_posix(): (
            DatasetDocument.load(path).content_sha256
            if path.name == OTHER_DOCUMENT
            else sha256_file(path)
        )
        for path in root.rglob("*")
        if path.is_file() and path.name not in without
    }
