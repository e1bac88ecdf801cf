"""What all tabs of one labeling server share: the run, its index, leases, journals and scenes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from codediffuser.datagen.episode import list_episodes
from codediffuser.datagen.episode_format import EPISODES
from codediffuser.errors import EpisodeError
from codediffuser.labeling.gui.episode_scene import EpisodeScene, SceneCache, load_scene
from codediffuser.labeling.gui.journal import Journal
from codediffuser.labeling.gui.reference_book import ReferenceBook
from codediffuser.labeling.index import Filter, LabelIndex, index_row, load_index
from codediffuser.labeling.instances import InstanceSource, get_instance_source
from codediffuser.labeling.leases import LeaseBook

REFRESH_S = 2.0
"""How old the index may be: other servers of the same run write labels too."""


class Desk:
    """Shared state of a labeling server. Thread-safe.

    Args:
        run: Run folder with episodes.
        source: Who finds the instances, or the registered name of one.
        prelabel: Registered name of a proposal that new drafts begin with; None for an empty one.
        references: Where reference mode keeps features; None for no such mode.
        clock: Unix time in seconds.

    Raises:
        EpisodeError: The run has no episodes.
        NotRegisteredError: No such source.
    """

    def __init__(
        self,
        run: Path,
        *,
        source: str | InstanceSource = "oracle",
        prelabel: str | None = None,
        references: ReferenceBook | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        if not list_episodes(run):
            raise EpisodeError(f"{run}: no episodes to label; run `codediffuser demo {run}` first")
        self.run, self.prelabel, self.clock = run, prelabel, clock
        self.references = references
        found_by = get_instance_source(source) if isinstance(source, str) else source
        self.scenes = SceneCache(lambda folder: load_scene(folder, found_by))
        self.leases = LeaseBook(run, clock)
        self._lock = threading.RLock()
        self._journals: dict[str, Journal] = {}
        self._index = load_index(run)
        self._read_at = clock()

    def folder(self, episode_id: str) -> Path:
        """Folder of an episode."""
        return self.run / EPISODES / episode_id

    def scene(self, episode_id: str) -> EpisodeScene:
        """Everything about one episode."""
        return self.scenes.get(self.folder(episode_id))

    def journal(self, operator: str) -> Journal:
        """The drafts of an operator; all tabs of this server share one."""
        with self._lock:
            if operator not in self._journals:
                self._journals[operator] = Journal(self.run, operator)
            return self._journals[operator]

    @property
    def index(self) -> LabelIndex:
        """All episodes as they stand, at most `REFRESH_S` old."""
        with self._lock:
            if self.clock() - self._read_at > REFRESH_S:
                self._index, self._read_at = load_index(self.run), self.clock()
            return self._index

    def changed(self, episode_id: str) -> None:
        """Bring the row of one episode up to date, after this server wrote its labels."""
        with self._lock:
            row = index_row(self.folder(episode_id))
            rows = tuple(row if r.episode_id == episode_id else r for r in self._index.rows)
            self._index = LabelIndex(rows=rows)

    def after(
        self, episode_id: str | None, wanted: Filter, operator: str, *, step: int = 1
    ) -> list[str]:
        """Episodes of a filter in the order they come up from an episode on, without itself.

        Args:
            episode_id: Where to begin; None begins before the first.
            wanted: Which ones.
            operator: For whom.
            step: 1 forward, -1 backward; both go round.
        """
        everything = [row.episode_id for row in self.index.rows][::step]
        at = everything.index(episode_id) + 1 if episode_id in everything else 0
        member = set(self.index.ids(wanted, operator))
        turned = [*everything[at:], *everything[:at]]
        return [name for name in turned if name in member and name != episode_id]

    def close(self) -> None:
        """Write the index and close the journals."""
        with self._lock:
            load_index(self.run)
            for journal in self._journals.values():
                journal.close()
            self.scenes.close()
