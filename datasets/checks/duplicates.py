"""Does an episode come twice? What trains would then also validate."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np

from codediffuser.datagen.episode_check import Finding
from codediffuser.datasets.checks.rows import EpisodeRows
from codediffuser.datasets.features import ACTION, STATE


class Duplicates:
    """Remembers state and action of every episode by their hash."""

    def __init__(self) -> None:
        self._seen: dict[str, int] = {}

    def check(self, episode: EpisodeRows) -> Iterator[Finding]:
        """Tell an episode whose motion was seen before."""
        motion = np.hstack([episode.columns[STATE], episode.columns[ACTION]])
        content = hashlib.sha256(np.ascontiguousarray(motion).tobytes()).hexdigest()
        if content in self._seen:
            first = self._seen[content]
            what = f"state and action are those of episode {first}, number for number"
            remedy = "delete one of them: one may train while the other validates"
            yield Finding("dataset.duplicate", episode.where, what, remedy)
        self._seen.setdefault(content, int(episode.meta["episode_index"]))
