"""Labels a whole run of simulated episodes without an operator, several episodes at a time.

The points come from the simulator's shapes, or from the instances that features find where the
targets were logged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.task import Task, get_task
from codediffuser.datagen.workers import run_tasks
from codediffuser.errors import CodeDiffuserError, ConfigError, EpisodeError
from codediffuser.labeling.ground_truth import ground_truth_labels
from codediffuser.labeling.label import AttentionLabel
from codediffuser.labeling.store import LabelSet, has_labels, load_labels, save_labels
from codediffuser.pointcloud import crop_box, fuse_views
from codediffuser.registry import unknown_name

SOURCES = ("oracle", "features")
"""Where the points of automatic labels may come from."""

_Answer = tuple[str, dict[str, int], str]
"""Id of the episode, points by role, error."""


@dataclass(frozen=True, slots=True)
class LabelResult:
    """What became of one episode."""

    episode_id: str
    index: int
    """How many episodes were done before this one."""
    total: int
    num_points: dict[str, int]
    """Points of each label by role; empty when there is an error."""
    error: str = ""
    """Why the episode got no labels."""


def label_run(
    run: Path, *, workers: int = 1, overwrite: bool = False, source: str = "oracle"
) -> Iterator[LabelResult]:
    """Give every episode of a run labels of its logged targets.

    Args:
        run: Run folder.
        workers: Processes; the labels are the same for any number.
        overwrite: Also replace labels that are already there, as a new revision.
        source: One of `SOURCES`.

    Yields:
        One result per episode. An episode that cannot be labelled is a result with an error.

    Raises:
        EpisodeError: The run has no episodes.
        ConfigError: No such source.
    """
    if source not in SOURCES:
        raise ConfigError(unknown_name("source of automatic labels", source, list(SOURCES)))
    folders = list_episodes(run)
    if not folders:
        raise EpisodeError(f"{run}: no episodes to label; run `codediffuser demo {run}` first")
    for index, (name, counts, error) in enumerate(_results(folders, workers, overwrite, source)):
        yield LabelResult(name, index, len(folders), counts, error)


def label_episode(folder: Path, *, overwrite: bool = False, source: str = "oracle") -> LabelSet:
    """Give one simulated episode labels of its logged targets and save them.

    Labels that are already there stay unless `overwrite` is set; the same labels again add no
    revision.

    Raises:
        LabelError: The cloud of frame 0 shows too little of a target, features find nothing where
            it was logged, or the labels that are there are damaged or of another episode.
        EpisodeError: The folder is damaged, or holds no scene or states.
    """
    if has_labels(folder) and not overwrite:
        return load_labels(folder)
    episode = Episode.open(folder)
    task = get_task(episode.scene.task)
    labels = _true_labels(episode, task) if source == "oracle" else _found_labels(episode, task)
    return save_labels(folder, labels)


def start_cloud(episode: Episode, task: Task) -> np.ndarray:
    """Points (N, 3) float32 that all cameras see in the task's workspace at frame 0, metres."""
    frame = episode.frame(0, color=False)
    views = [(frame.depth_m[n], c.K, c.T_world_camera) for n, c in episode.depth_cameras.items()]
    box = task.config.workspace
    return crop_box(fuse_views(views), np.array(box.low_m), np.array(box.high_m))


def _true_labels(episode: Episode, task: Task) -> tuple[AttentionLabel, AttentionLabel]:
    trajectory = episode.trajectory
    T_world_start = {name: trajectory.T_world_object(name, 0) for name in trajectory.object_ids}
    return ground_truth_labels(task, episode.scene, T_world_start, start_cloud(episode, task))


def _found_labels(episode: Episode, task: Task) -> tuple[AttentionLabel, AttentionLabel]:
    from codediffuser.labeling.perception.instances import shared_source
    from codediffuser.labeling.perception.logged import logged_labels

    return logged_labels(episode, task, shared_source())


def _results(
    folders: Sequence[Path], workers: int, overwrite: bool, source: str
) -> Iterator[_Answer]:
    jobs = [(folder, overwrite, source) for folder in folders]
    if workers <= 1:
        yield from map(_job, jobs)
        return
    for outcome in run_tasks(_job, jobs, workers=workers):
        yield outcome.value or (outcome.task[0].name, {}, outcome.error)


def _job(job: tuple[Path, bool, str]) -> _Answer:
    folder, overwrite, source = job
    try:
        labels = label_episode(folder, overwrite=overwrite, source=source)
    except CodeDiffuserError as error:
        return folder.name, {}, str(error)
    return folder.name, {label.role: len(label.points_world) for label in labels.labels}, ""
