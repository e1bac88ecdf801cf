"""Leases: who works on which episode right now, across tabs, servers and machines of one run.

A lease keeps two people from doing the same work; it guards nothing. What guards labels is the
revision that every submit names. So a lost or broken lease file costs at most a refused submit.
"""

from __future__ import annotations

import contextlib
import fcntl
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import ClassVar

from codediffuser.errors import CodeDiffuserError
from codediffuser.labeling.index import LABELING
from codediffuser.schema import Document, Strict

LEASES = "leases.json"
LEASE_S = 60.0
"""A lease that was not renewed for so long is free: its tab or its server has died."""


class Lease(Strict):
    """One tab's claim to one episode."""

    episode_id: str
    holder: str
    """Id of the tab."""
    operator: str
    until_s: float
    """Unix time."""


class LeaseFile(Document):
    """All leases of a run (`schema: codediffuser.leases/1`)."""

    KIND: ClassVar[str] = "leases"
    VERSION: ClassVar[int] = 1

    leases: tuple[Lease, ...] = ()


class LeaseBook:
    """Takes, renews and gives back leases in `RUN/labeling/leases.json`.

    Args:
        run: Run folder.
        clock: Unix time in seconds, the same for everybody who shares the run.
    """

    def __init__(self, run: Path, clock: Callable[[], float] = time.time) -> None:
        self._path = run / LABELING / LEASES
        self._clock = clock
        self._path.parent.mkdir(parents=True, exist_ok=True)

    def claim(self, episode_ids: Iterable[str], holder: str, operator: str) -> str | None:
        """Lease the first of these episodes that nobody else holds, and give back the tab's others.

        Returns:
            Its id; None when all are taken, and then the tab keeps what it has.
        """
        with self._edit() as leases:
            taken = {lease.episode_id for lease in leases if lease.holder != holder}
            chosen = next((name for name in episode_ids if name not in taken), None)
            if chosen is not None:
                leases[:] = [lease for lease in leases if lease.holder != holder]
                leases.append(self._lease(chosen, holder, operator))
            return chosen

    def renew(self, holder: str) -> None:
        """Extend the leases of a tab that is still there."""
        with self._edit() as leases:
            leases[:] = [
                self._lease(x.episode_id, holder, x.operator) if x.holder == holder else x
                for x in leases
            ]

    def release(self, holder: str) -> None:
        """Give back everything that a tab holds."""
        with self._edit() as leases:
            leases[:] = [lease for lease in leases if lease.holder != holder]

    def other(self, episode_id: str, holder: str) -> str | None:
        """Name of another operator or tab that works on the episode; None when nobody does."""
        found = [
            lease.operator
            for lease in self._read()
            if lease.episode_id == episode_id and lease.holder != holder
        ]
        return found[0] if found else None

    def _lease(self, episode_id: str, holder: str, operator: str) -> Lease:
        return Lease(
            episode_id=episode_id, holder=holder, operator=operator,
            until_s=self._clock() + LEASE_S,
        )  # fmt: skip

    def _read(self) -> list[Lease]:
        try:
            leases = LeaseFile.load(self._path).leases
        except CodeDiffuserError:
            return []
        return [lease for lease in leases if lease.until_s > self._clock()]

    @contextlib.contextmanager
    def _edit(self) -> Iterator[list[Lease]]:
        """Yield the living leases and write them back, one process at a time."""
        with (self._path.parent / f".{LEASES}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            leases = self._read()
            before = list(leases)
            yield leases
            if leases != before:
                LeaseFile(leases=tuple(leases)).save(self._path)
