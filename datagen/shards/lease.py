"""Leases on shards: who works on one, and until when. Files on a shared folder, no server.

A lease is taken by linking a finished file to its name, which succeeds for one of several takers on
local disks and on NFS. It is renewed while its holder works, and runs out when the holder dies. On
the machine of a dead holder it is free at once. Clocks of different machines may differ by less
than the lease's length.
"""

from __future__ import annotations

import contextlib
import os
import platform
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from codediffuser.datagen.shards.plan import SHARDS
from codediffuser.errors import CodeDiffuserError
from codediffuser.files import partial_path
from codediffuser.schema import Document

LEASES = "leases"
LEASE_S = 60.0


class LeaseHeldError(CodeDiffuserError):
    """Somebody else works on a shard."""

    def __init__(self, shard_id: str, owner: str, left_s: float) -> None:
        super().__init__(shard_id, owner, left_s)
        self.left_s = left_s

    def __str__(self) -> str:
        shard_id, owner, left_s = self.args
        return f"shard {shard_id}: {owner} works on it for at least {left_s:.0f} s more"


class LeaseLostError(CodeDiffuserError):
    """A lease ran out and somebody else has taken it; whoever has lost it stops."""


class Lease(Document):
    """`leases/<shard>.json` (`schema: codediffuser.shard_lease/1`)."""

    KIND: ClassVar[str] = "shard_lease"
    VERSION: ClassVar[int] = 1

    shard: str
    machine: str
    pid: int
    token: str
    """Of this one taking of the lease."""
    expires_s: float
    """Seconds since the epoch."""

    @property
    def owner(self) -> str:
        """Who holds it, for people."""
        return f"process {self.pid} on {self.machine}"

    @property
    def left_s(self) -> float:
        """Seconds until it may be taken; 0 when its holder on this machine is dead."""
        if self.machine == platform.node() and not Path(f"/proc/{self.pid}").exists():
            return 0.0
        return max(self.expires_s - time.time(), 0.0)


def lease_path(run: Path, shard_id: str) -> Path:
    """Where the lease of a shard lies."""
    return run / SHARDS / LEASES / f"{shard_id}.json"


@contextlib.contextmanager
def holding(run: Path, shard_id: str, lease_s: float = LEASE_S) -> Iterator[threading.Event]:
    """Hold the lease of a shard inside the block; a thread renews it.

    Yields:
        Event that is set when the lease is lost; work should stop then.

    Raises:
        LeaseHeldError: Somebody else holds it.
    """
    token = take(run, shard_id, lease_s)
    lost, ended = threading.Event(), threading.Event()

    def keep() -> None:
        while not ended.wait(lease_s / 3):
            try:
                renew(run, shard_id, token, lease_s)
            except (CodeDiffuserError, OSError):
                lost.set()
                return

    keeper = threading.Thread(target=keep, name=f"lease-{shard_id}", daemon=True)
    keeper.start()
    try:
        yield lost
    finally:
        ended.set()
        keeper.join()
        release(run, shard_id, token)


def take(run: Path, shard_id: str, lease_s: float = LEASE_S) -> str:
    """Take the lease of a shard and return its token.

    Raises:
        LeaseHeldError: Somebody else holds it.
    """
    path, lease = lease_path(run, shard_id), _new_lease(shard_id, lease_s)
    for _ in range(2):
        if publish(lease, path):
            return lease.token
        held = _read(path)
        if held is None:
            continue
        if held.left_s > 0:
            raise LeaseHeldError(shard_id, held.owner, held.left_s)
        _discard(path, held)
    raise LeaseHeldError(shard_id, "somebody quicker", 1.0)


def renew(run: Path, shard_id: str, token: str, lease_s: float = LEASE_S) -> None:
    """Make a lease last anew.

    Raises:
        LeaseLostError: Somebody else has taken it.
    """
    path = lease_path(run, shard_id)
    held = _read(path)
    if held is None or held.token != token:
        raise LeaseLostError(f"shard {shard_id}: its lease ran out and was taken by another")
    held.model_copy(update={"expires_s": time.time() + lease_s}).save(path)


def release(run: Path, shard_id: str, token: str) -> None:
    """Give a lease back; one that was lost is left to its new holder."""
    path = lease_path(run, shard_id)
    held = _read(path)
    if held is not None and held.token == token:
        path.unlink(missing_ok=True)


def publish(document: Document, path: Path) -> bool:
    """Write a document to a name that nobody has; False when somebody has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # Threads of one process may publish under the same name.
    partial = partial_path(path).with_suffix(f".{uuid.uuid4().hex}.json")
    document.save(partial)
    try:
        os.link(partial, path)
    except FileExistsError:
        return False
    finally:
        partial.unlink()
    return True


def _new_lease(shard_id: str, lease_s: float) -> Lease:
    return Lease(
        shard=shard_id,
        machine=platform.node(),
        pid=os.getpid(),
        token=uuid.uuid4().hex,
        expires_s=time.time() + lease_s,
    )


def _read(path: Path) -> Lease | None:
    """The lease at a path, or None when there is none."""
    return Lease.load(path) if path.is_file() else None


def _discard(path: Path, stale: Lease) -> None:
    """Put away a lease that has run out; a fresh one that came between is put back."""
    aside = path.with_name(f".stale-{uuid.uuid4().hex}.json")
    with contextlib.suppress(FileNotFoundError):
        os.rename(path, aside)
        if Lease.load(aside).token != stale.token:
            with contextlib.suppress(FileExistsError):
                os.link(aside, path)
        aside.unlink()
