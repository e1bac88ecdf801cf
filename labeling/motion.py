"""How the objects that labels follow move through a recorded episode."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import get_task
from codediffuser.errors import EpisodeError, LabelError
from codediffuser.labeling.label import AttentionLabel

if TYPE_CHECKING:
    from codediffuser.labeling.perception.tracking import Track

FOUND = "found_"
"""Begins the ids of instances that perception found; the simulator has no object of such a name."""


class RecordedMotion:
    """Poses of the followed objects at each frame of an episode.

    Objects that perception found are tracked through the pictures, since no simulator knows them;
    where cameras and hand poses allow it, real recordings work too.

    Args:
        episode: Where the poses were recorded; its simulator states are read only when some label
            follows one of the simulator's objects.
        labels: Labels of that episode.

    Raises:
        LabelError: A label follows an object whose motion the episode does not hold.
    """

    def __init__(self, episode: Episode, labels: Sequence[AttentionLabel]) -> None:
        self._episode = episode
        followed = {label.follows: label for label in labels if label.follows is not None}
        self._tracked = {i: _track(episode, f) for i, f in followed.items() if i.startswith(FOUND)}
        self._ids = sorted(i for i in followed if i not in self._tracked)
        if not self._ids:
            return
        try:
            recorded = episode.trajectory.object_ids
        except EpisodeError as error:
            raise LabelError(
                f"{episode.folder}: a label follows '{self._ids[0]}', but the motion of objects "
                f"was not recorded: {error}"
            ) from None
        for name in self._ids:
            if name not in recorded:
                raise LabelError(
                    f"{episode.folder}: a label follows '{name}', which did not move in this "
                    f"episode; recorded are: {', '.join(recorded)}"
                )

    def at(self, frame: int) -> dict[str, np.ndarray]:
        """Pose (4, 4) float64 in the world of each followed object at one frame, by id."""
        poses = {name: self._episode.trajectory.T_world_object(name, frame) for name in self._ids}
        return poses | {name: track.T_now_start[frame] for name, track in self._tracked.items()}

    def confidence(self, frame: int) -> float:
        """How sure the poses at one frame are, in [0, 1]: those of the simulator are."""
        return min([1.0, *(float(track.confidence[frame]) for track in self._tracked.values())])


def _track(episode: Episode, label: AttentionLabel) -> Track:
    """Track the points of a label; the last few tracks are kept, for one takes seconds."""
    points = np.ascontiguousarray(label.points_world, dtype=np.float32)
    return _kept_track(episode.folder, episode.manifest.content_hash, label.category,
                       points.tobytes())  # fmt: skip


@functools.lru_cache(maxsize=16)
def _kept_track(folder: Path, content_hash: str, category: str, points: bytes) -> Track:
    from codediffuser.labeling.perception.instances import looking_for
    from codediffuser.labeling.perception.tracking import track_object

    episode = Episode.open(folder)
    cloud = np.frombuffer(points, dtype=np.float32).reshape(-1, 3)
    return track_object(episode, cloud, looking_for(category, get_task(episode.manifest.task)))
