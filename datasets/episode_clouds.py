"""One labelled episode to the columns of the `pointcloud` profile."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import get_task
from codediffuser.datasets.clouds import CloudConfig, View, cloud_rng, policy_cloud
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.store import load_labels
from codediffuser.poses import make_transform, rot6d_to_matrix


@dataclass(frozen=True, slots=True)
class EpisodeColumns:
    """Columns of one episode of T frames."""

    points: np.ndarray
    """(T, N * 5) float32, see `features.POINTS`."""
    state: np.ndarray
    """(T, 10) float32."""
    action: np.ndarray
    """(T, 10) float32."""


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
    for frame in episode.frames(list(cameras), color=False):
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


def _address(episode: Episode) -> tuple[int, int]:
    """Root seed and index of the episode's generators."""
    seed = episode.manifest.seed
    if seed is not None:
        return seed.root, seed.index
    # A real recording has no seed; its content stands in.
    return 0, int(episode.manifest.content_hash[:8], 16)
