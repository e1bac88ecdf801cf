"""How the objects that labels follow move through a recorded episode."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.errors import EpisodeError, LabelError
from codediffuser.labeling.label import AttentionLabel


class RecordedMotion:
    """Poses of the followed objects at each frame of an episode.

    Args:
        episode: Where the poses were recorded; its simulator states are read only when some label
            follows an object.
        labels: Labels of that episode.

    Raises:
        LabelError: A label follows an object whose motion the episode does not hold.
    """

    def __init__(self, episode: Episode, labels: Sequence[AttentionLabel]) -> None:
        self._episode = episode
        self._ids = sorted({label.follows for label in labels if label.follows is not None})
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
        return {name: self._episode.trajectory.T_world_object(name, frame) for name in self._ids}
