"""One labelled episode to the columns of its export, kept on disk until the export is whole."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codediffuser import pointcloud, poses
from codediffuser.datagen.episode import Episode, load_manifest
from codediffuser.datagen.task import get_task
from codediffuser.datasets import clouds
from codediffuser.datasets.clouds import CloudConfig, View, cloud_rng, policy_cloud
from codediffuser.errors import CodeDiffuserError, DatasetError
from codediffuser.files import atomic_path, sha256_file, sha256_json
from codediffuser.labeling import attention, motion
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.store import LABELS, episode_sha256, load_labels
from codediffuser.poses import make_transform, rot6d_to_matrix


@dataclass(frozen=True, slots=True)
class CloudJob:
    """What a worker needs to make one episode's columns, and where to keep them."""

    folder: Path
    config: CloudConfig
    kept_in: Path
    code: str
    """`code_fingerprint`; other code makes its own files."""

    @property
    def path(self) -> Path:
        """File of the result, named by everything that goes into it."""
        key = sha256_json(
            {
                "log": load_manifest(self.folder).content_hash,
                "episode": episode_sha256(load_manifest(self.folder)),
                "labels": sha256_file(self.folder / LABELS),
                "cloud": self.config.model_dump(mode="json"),
                "code": self.code,
            }
        )
        return self.kept_in / f"{self.folder.name}-{key[:16]}.npz"


@dataclass(frozen=True, slots=True)
class EpisodeColumns:
    """Columns of one episode of T frames."""

    points: np.ndarray
    """(T, N * 5) float32, see `features.POINTS`."""
    state: np.ndarray
    """(T, 10) float32."""
    action: np.ndarray
    """(T, 10) float32."""


def ensure_columns(job: CloudJob) -> bool:
    """Make and keep the columns of one episode unless a whole file is there already.

    Returns:
        Whether they were there.

    Raises:
        DatasetError: The episode cannot become a part of a dataset; the message says why.
    """
    path = job.path
    if path.exists():
        try:
            load_columns(path)
        except DatasetError:
            path.unlink()
        else:
            return True
    try:
        columns = episode_columns(job.folder, job.config)
    except CodeDiffuserError as error:
        raise DatasetError(f"episode {job.folder.name}: {error}") from error
    with atomic_path(path) as partial, partial.open("wb") as stream:
        np.savez(stream, points=columns.points, state=columns.state, action=columns.action)
    return False


def load_columns(path: Path) -> EpisodeColumns:
    """Read what `ensure_columns` keeps.

    Raises:
        DatasetError: The file is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as raw:
            return EpisodeColumns(raw["points"], raw["state"], raw["action"])
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{path}: not readable: {error}; run convert again") from None


def episode_columns(folder: Path, config: CloudConfig) -> EpisodeColumns:
    """Compute the policy cloud of every frame of one labelled episode.

    Raises:
        EpisodeError: The episode is damaged.
        LabelError: Its labels are missing, damaged, or follow an object of unknown motion.
        RenderError: A frame shows nothing of the workspace.
    """
    episode = Episode.open(folder)
    labels = load_labels(folder).labels
    recorded = RecordedMotion(episode, labels)
    field = AttentionField(labels, recorded.at(0), radius_m=config.attention_radius_m)
    box = get_task(episode.manifest.task).config.workspace
    low, high = np.array(box.low_m), np.array(box.high_m)
    root_seed, index = _address(episode)
    state, cameras = episode.state, episode.depth_cameras
    hands = make_transform(rot6d_to_matrix(state[:, 3:9]), state[:, :3])
    points = np.empty((episode.num_frames, config.num_points * 5), dtype=np.float32)
    for frame in episode.frames(color=False):
        t = frame.index
        views = [View(frame.depth_m[n], c.K, c.T_world_camera) for n, c in cameras.items()]
        cloud = policy_cloud(
            views,
            field,
            recorded.at(t),
            hands[t],
            low,
            high,
            cloud_rng(root_seed, index, t),
            config,
        )
        points[t] = cloud.reshape(-1)
    return EpisodeColumns(points, state, episode.actions)


def code_fingerprint() -> str:
    """Hash of the source files that decide what a cloud holds, committed or not."""
    modules = (clouds, attention, motion, pointcloud, poses)
    paths = [Path(__file__), *(Path(str(module.__file__)) for module in modules)]
    return sha256_json([sha256_file(path) for path in paths])


def labels_json(folder: Path) -> str:
    """The labels of an episode as one line of JSON: targets and revision, nothing said about them.

    A flag, a review or who saved them thus makes no export stale.
    """
    document = load_labels(folder).document.model_dump(mode="json", by_alias=True)
    for said_about in ("history", "saved", "flags", "reviews"):
        del document[said_about]
    return json.dumps(document, sort_keys=True, separators=(",", ":"))


def _address(episode: Episode) -> tuple[int, int]:
    """Root seed and index of the episode's generators."""
    seed = episode.manifest.seed
    if seed is not None:
        return seed.root, seed.index
    # A real recording has no seed; its content stands in.
    return 0, int(episode.manifest.content_hash[:8], 16)
