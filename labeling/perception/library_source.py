"""Instances by a library of references that people clicked, with any feature backend."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import Task
from codediffuser.errors import LabelError
from codediffuser.labeling.instances import SelectableInstance
from codediffuser.labeling.perception.features import FeatureOptions, get_features
from codediffuser.labeling.perception.finding import find_instances
from codediffuser.labeling.perception.instances import selectable
from codediffuser.labeling.perception.references import load_references
from codediffuser.labeling.perception.views import views_at


class LibrarySource:
    """An instance source that looks for what a library file describes.

    The file is read anew for each episode, so references that are added meanwhile count.

    Args:
        backend: Registered name of the feature backend.
        path: The library file, of that backend.
        options: What the backend is built from; the episode is filled in here.
    """

    def __init__(self, backend: str, path: Path, options: FeatureOptions | None = None) -> None:
        self.backend, self.path = backend, path
        self._options = options or FeatureOptions()

    def instances(self, episode: Episode, task: Task) -> tuple[SelectableInstance, ...]:
        """Objects that wait, then places, each in lexicographic order of where they are.

        Raises:
            LabelError: The library holds no reference of the task's categories.
            ConfigError: The file is damaged, or of another backend.
            EpisodeError: No calibrated camera gives depth.
            SetupError: The backend's weights or packages are missing.
        """
        backend = get_features(self.backend, dataclasses.replace(self._options, episode=episode))
        library = load_references(self.path, backend)
        wanted = (task.pick_category, task.place_category)
        if not set(wanted) & set(library.categories):
            raise LabelError(
                f"{self.path}: no references of {' or '.join(wanted)} yet; press I and click some "
                "in the pictures, then open the episode again"
            )
        return selectable(find_instances(views_at(episode), task, backend, library), task)
