"""Shards on a Ray cluster: one actor a worker; actors and nodes may die at any time.

All nodes must see the run folder under the same path and have codediffuser installed.
"""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from codediffuser.datagen.shards.run import ShardTask, WorkerDiedError, run_shard
from codediffuser.errors import CodeDiffuserError, SetupError

START_TIMEOUT_S = 300.0
"""After so long without any actor, the cluster has no room for one."""


class _ShardActor:
    """Runs one shard after another on a node of the cluster."""

    def ready(self) -> int:
        """Answer with the process id once the actor is there."""
        return os.getpid()

    def run(self, task: ShardTask) -> Exception | None:
        """Run a shard; an error is answered, not raised, so that it arrives as what it is."""
        try:
            run_shard(task)
        except CodeDiffuserError as error:
            return error
        return None


class RayExecutor:
    """Runs shards on Ray actors.

    Args:
        workers: How many actors, each with a CPU of its own.
        address: Of a running cluster; None takes the one of `RAY_ADDRESS`, or starts one here.

    Raises:
        SetupError: Ray is not installed, or there is no cluster at the address.
    """

    def __init__(self, workers: int = 1, address: str | None = None) -> None:
        self.workers = max(workers, 1)
        self._ray = _connect(address, self.workers)
        self._actor_type = self._ray.remote(num_cpus=1, max_restarts=0)(_ShardActor)

    def run(self, tasks: Sequence[ShardTask]) -> Iterator[tuple[ShardTask, Exception | None]]:
        """Run every task; yield each when it ends, with what went wrong."""
        crew = _Crew(self._ray, self._actor_type)
        waiting = deque(tasks)
        crew.start(min(self.workers, len(waiting)))
        try:
            while waiting or crew.busy:
                while waiting and crew.idle:
                    crew.give(waiting.popleft())
                yield from crew.hear()
        finally:
            crew.dismiss()


class _Crew:
    """Actors that start, wait or work."""

    def __init__(self, ray: Any, actor_type: Any) -> None:
        self._ray = ray
        self._actor_type = actor_type
        self._starting: dict[Any, Any] = {}
        self.idle: list[Any] = []
        self.busy: dict[Any, tuple[Any, ShardTask]] = {}

    def start(self, count: int) -> None:
        """Ask for actors; each counts once it has answered, since a full cluster gives none."""
        for _ in range(count):
            actor = self._actor_type.remote()
            self._starting[actor.ready.remote()] = actor

    def give(self, task: ShardTask) -> None:
        """Let an idle actor run a shard."""
        actor = self.idle.pop()
        self.busy[actor.run.remote(task)] = (actor, task)

    def hear(self) -> Iterator[tuple[ShardTask, Exception | None]]:
        """Wait for news of any actor; yield a task that has ended."""
        answers = [*self._starting, *self.busy]
        timeout = None if self.busy else START_TIMEOUT_S
        heard, _ = self._ray.wait(answers, num_returns=1, timeout=timeout)
        if not heard:
            raise SetupError(
                f"no Ray actor started within {START_TIMEOUT_S:.0f} s: the cluster has no free CPU "
                f"({self._ray.available_resources()}); free some, or ask for fewer --workers"
            )
        for answer in heard:
            actor = self._starting.pop(answer, None)
            task = None
            if actor is None:
                actor, task = self.busy.pop(answer)
            try:
                answered = self._ray.get(answer)
            except self._ray.exceptions.RayError as died:
                error: Exception | None = died
                if not isinstance(died, self._ray.exceptions.RayTaskError):
                    error = WorkerDiedError(f"a Ray worker died: {str(died).splitlines()[0]}")
                self.start(1)
            else:
                error = answered if isinstance(answered, Exception) else None
                self.idle.append(actor)
            if task is not None:
                yield task, error

    def dismiss(self) -> None:
        """End all actors."""
        working = [actor for actor, _ in self.busy.values()]
        for actor in (*self.idle, *self._starting.values(), *working):
            self._ray.kill(actor)


def _connect(address: str | None, workers: int) -> Any:
    """Import Ray and join a cluster, or start one that is only for this machine."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError:
        raise SetupError(
            "the ray executor needs Ray, which is not installed: pip install 'codediffuser[ray]'"
        ) from None
    if ray.is_initialized():
        return ray
    # Without "local", Ray would join whatever cluster it finds on this machine.
    address = address or os.environ.get("RAY_ADDRESS") or "local"
    # A cluster of one's own listens to this machine alone.
    here: dict[str, Any] = {
        "num_cpus": workers, "include_dashboard": False, "_node_ip_address": "127.0.0.1",
    }  # fmt: skip
    try:
        ray.init(
            address=address, log_to_driver=False, logging_level=logging.WARNING,
            **(here if address == "local" else {}),
        )  # fmt: skip
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise SetupError(
            f"no Ray cluster at '{address}' ({error}); start one with 'ray start --head', or leave "
            "the address out"
        ) from None
    return ray
