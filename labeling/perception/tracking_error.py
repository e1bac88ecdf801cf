"""Judges how well a picked object is followed without its poses, on simulated demonstrations.

`python -m codediffuser.labeling.perception.tracking_error RUN...` finds the picked object of each
episode by features, follows it by `track_object`, and compares where its attended points are taken
with where the simulator's poses take them: the mean distance of the points, in each frame. It
prints median, 95th percentile and maximum by task and phase:

* *before*: until the object has moved by 2 mm;
* *carried*: until the fingers open;
* *released*: from there to the end.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.task import get_task
from codediffuser.errors import EpisodeError, LabelError
from codediffuser.labeling.perception.instances import looking_for, shared_source
from codediffuser.labeling.perception.logged import logged_labels
from codediffuser.labeling.perception.tracking import track_object
from codediffuser.poses import apply_transform, invert_transform

PHASES = ("before", "carried", "released")
MOVED_M = 0.002
"""An object that has moved by more is carried."""
OPENS_M = 0.002
"""A finger that opens by more than this beyond its narrowest lets go."""


@dataclass(frozen=True, slots=True)
class TrackingError:
    """How one object was followed."""

    task: str
    episode_id: str
    error_m: np.ndarray
    """(T,) float64: mean distance of its points to where they truly are."""
    phase: np.ndarray
    """(T,) int64, index into `PHASES`."""
    confidence: np.ndarray
    """(T,) float32, of the track."""


def judge_tracking(episode: Episode) -> TrackingError:
    """Follow the picked object of a simulated demonstration and compare with its poses.

    Raises:
        EpisodeError: A real recording, which has no scene file or states.
        LabelError: Features do not find the object.
    """
    task, trajectory = get_task(episode.scene.task), episode.trajectory
    label, _ = logged_labels(episode, task, shared_source())
    points = label.points_world.astype(np.float64)
    track = track_object(episode, label.points_world, looking_for(label.category, task))
    pick = episode.scene.target.pick
    from_start = invert_transform(trajectory.T_world_object(pick, 0))
    true = np.stack(
        [
            apply_transform(trajectory.T_world_object(pick, k) @ from_start, points)
            for k in range(episode.num_frames)
        ]
    )
    followed = np.stack([apply_transform(T, points) for T in track.T_now_start])
    moved_m = np.linalg.norm(true - points, axis=-1).mean(axis=-1)
    return TrackingError(
        task.name,
        episode.id,
        np.linalg.norm(followed - true, axis=-1).mean(axis=-1),
        phases(moved_m, episode.state[:, 9]),
        track.confidence,
    )


def phases(moved_m: np.ndarray, opening_m: np.ndarray) -> np.ndarray:
    """Tell the phase of each frame, (T,) int64 indices into `PHASES`.

    Args:
        moved_m: (T,) how far the object is from where it was at frame 0.
        opening_m: (T,) mean opening of the fingers.
    """
    phase = np.zeros(len(moved_m), dtype=np.int64)
    moved = np.flatnonzero(moved_m > MOVED_M)
    if len(moved) == 0:
        return phase
    first = moved[0]
    phase[first:] = 1
    grip_m = np.minimum.accumulate(opening_m[first:])
    opened = np.flatnonzero(opening_m[first:] > grip_m + OPENS_M)
    if len(opened):
        phase[first + opened[0] :] = 2
    return phase


def report(errors: Sequence[TrackingError]) -> list[str]:
    """Lines to print: a table by task and phase."""
    lines = ["task          phase     frames   median      p95      max   confidence"]
    for task in dict.fromkeys(e.task for e in errors):
        mine = [e for e in errors if e.task == task]
        phase = np.concatenate([e.phase for e in mine])
        error_mm = 1e3 * np.concatenate([e.error_m for e in mine])
        sure = np.concatenate([e.confidence for e in mine])
        for number, name in enumerate(PHASES):
            here = phase == number
            if here.any():
                median, high, most = np.percentile(error_mm[here], [50, 95, 100])
                lines.append(
                    f"{task:13} {name:9} {here.sum():6} {median:6.1f} mm {high:5.1f} mm "
                    f"{most:5.1f} mm   {np.median(sure[here]):.2f}"
                )
    return lines


def judge_runs(runs: Sequence[Path], episodes: int | None = None) -> Iterator[TrackingError | str]:
    """Judge the first episodes of some runs; one that cannot be judged gives a line that says why.

    Raises:
        EpisodeError: A run has no episodes.
    """
    for run in runs:
        folders = list_episodes(run)[:episodes]
        if not folders:
            raise EpisodeError(f"{run}: no episodes to judge; run `codediffuser demo {run}` first")
        for folder in folders:
            try:
                yield judge_tracking(Episode.open(folder))
            except LabelError as error:
                yield f"{folder}: {error}"


@dataclass(frozen=True, slots=True)
class TrackingOptions:
    """Options of the command."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Runs with recorded simulated episodes, of any tasks."""
    episodes: int | None = None
    """Of each run at most so many."""


def main() -> None:
    """Print the table."""
    options = tyro.cli(TrackingOptions, description=__doc__)
    judged = list(judge_runs(options.runs, options.episodes))
    lines = report([e for e in judged if isinstance(e, TrackingError)])
    lines += [line for line in judged if isinstance(line, str)]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
