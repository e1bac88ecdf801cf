"""Shards on this machine: one thread a worker, whose episodes are made in a process of its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator, Sequence

from codediffuser.datagen.shards.run import ShardTask, run_shard


class LocalExecutor:
    """Runs shards on this machine.

    Args:
        workers: How many at a time.
    """

    def __init__(self, workers: int = 1) -> None:
        self.workers = max(workers, 1)

    def run(self, tasks: Sequence[ShardTask]) -> Iterator[tuple[ShardTask, Exception | None]]:
        """Run every task; yield each when it ends, with what went wrong."""
        waiting: queue.SimpleQueue[ShardTask] = queue.SimpleQueue()
        ended: queue.SimpleQueue[tuple[ShardTask, Exception | None]] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        for _ in range(min(self.workers, len(tasks))):
            # Daemons, so that Ctrl-C need not wait for a shard; its lease is free once we are gone.
            threading.Thread(target=_work, args=(waiting, ended), daemon=True).start()
        for _ in tasks:
            yield ended.get()


def _work(
    waiting: queue.SimpleQueue[ShardTask],
    ended: queue.SimpleQueue[tuple[ShardTask, Exception | None]],
) -> None:
    while True:
        try:
            task = waiting.get_nowait()
        except queue.Empty:
            return
        try:
            run_shard(task)
            ended.put((task, None))
        except Exception as error:
            # A thread's error ends nothing by itself: the caller of `run` is given it.
            ended.put((task, error))
