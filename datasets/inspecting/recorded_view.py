"""Episodes of a run for the viewers: the raw cloud of all depth cameras, coloured as seen."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.episode_format import Camera
from codediffuser.datagen.task import get_task
from codediffuser.datasets.inspecting.episode_view import (
    MAX_POINTS,
    Shelf,
    Shot,
    colored_points,
    joined,
    paint,
)
from codediffuser.errors import LabelError, NotRegisteredError
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.store import has_labels, load_labels
from codediffuser.pointcloud import inside_box


class RecordedView:
    """One episode folder.

    Args:
        folder: `RUN/episodes/<id>`.

    Raises:
        EpisodeError: It is damaged.
        LabelError: Its labels are damaged.
    """

    def __init__(self, folder: Path) -> None:
        self._episode = Episode.open(folder)
        manifest = self._episode.manifest
        self.id, self.hz = manifest.id, float(manifest.hz)
        end = "success" if manifest.success else f"failed: {manifest.reason}"
        self.title = f"{manifest.instruction} ({end})"
        self.names = manifest.motion.state_names, manifest.motion.action_names
        self.state, self.action = self._episode.state, self._episode.actions
        labels = load_labels(folder).labels if has_labels(folder) else ()
        try:
            self._motion = RecordedMotion(self._episode, labels)
        except LabelError:
            # Nobody recorded how objects moved: only what stands still can be shown.
            labels = tuple(label for label in labels if label.follows is None)
            self._motion = RecordedMotion(self._episode, labels)
        self._field = AttentionField(labels, self._motion.at(0))

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """Calibrated cameras that stand still."""
        return self._episode.cameras

    @functools.cached_property
    def _box(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The task's workspace; None for a task that is not known here."""
        try:
            box = get_task(self._episode.manifest.task).config.workspace
        except NotRegisteredError:
            return None
        return np.array(box.low_m), np.array(box.high_m)

    def shot(self, k: int) -> Shot:
        """Pictures of frame k, and the points that they show in the workspace.

        Raises:
            EpisodeError: The log is damaged.
        """
        frame = self._episode.frame(k)
        found = [
            colored_points(frame.depth_m[name], frame.rgb[name], camera)
            for name, camera in self._episode.depth_cameras.items()
        ]
        points = joined([points for points, _, _ in found], 3, np.float32)
        rgb = joined([rgb for _, rgb, _ in found], 3, np.uint8)
        if self._box is not None:
            near = inside_box(points, *self._box)
            points, rgb = points[near], rgb[near]
        step = max(1, -(-len(points) // MAX_POINTS))
        points, rgb = points[::step], rgb[::step]
        return Shot(points, paint(rgb, self._field.at(points, self._motion.at(k))), frame.rgb)


def run_shelf(run: Path) -> Shelf:
    """The episodes of a run by id."""
    folders = {folder.name: folder for folder in list_episodes(run)}
    return Shelf(tuple(folders), lambda name: RecordedView(folders[name]))
