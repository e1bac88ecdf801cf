"""What an operator can choose from: the instances of an episode at frame 0, and who finds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import Task
from codediffuser.labeling.label import Role
from codediffuser.registry import Registry


@dataclass(frozen=True, slots=True)
class SelectableInstance:
    """One thing or place of a scene that can become a target."""

    id: str
    """Unique within the episode."""
    category: str
    name: str
    """What a person would call it: `green battery`."""
    role: Role | None
    """What it can be the target of; None when it may be either."""
    points_world: np.ndarray
    """(N, 3) float32, metres, N >= 1: every reading of it at frame 0, not thinned."""
    follows: str | None = None
    """Id of the object whose motion carries the points; None for what stands still."""
    taken_by: str = ""
    """Name of what stands there already; empty for a free place or an object."""
    confidence: float = 1.0
    """How sure its finder is that it is one whole instance of its category."""

    @property
    def centroid_world(self) -> np.ndarray:
        """(3,) float64 mean of its points, metres."""
        return np.asarray(self.points_world.mean(axis=0, dtype=np.float64))


class InstanceSource(Protocol):
    """Finds instances. One object serves many episodes and threads."""

    def instances(self, episode: Episode, task: Task) -> tuple[SelectableInstance, ...]:
        """Instances at frame 0 in a stable order, ids unique; none when nothing is seen.

        Raises:
            CodeDiffuserError: The episode lacks what the source needs; the message says what.
        """


INSTANCE_SOURCES: Registry[Callable[[], InstanceSource]] = Registry("instance source")


def get_instance_source(name: str) -> InstanceSource:
    """Build a registered source.

    Raises:
        NotRegisteredError: No such source; the message names the closest one.
    """
    import codediffuser.labeling.oracle_source
    import codediffuser.labeling.perception.instances  # noqa: F401  both fill the registry

    return INSTANCE_SOURCES.get(name)()
