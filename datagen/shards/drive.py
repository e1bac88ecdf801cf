"""Runs a plan to its end on an executor, however often workers die on the way."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from codediffuser.datagen.collect import CollectOptions
from codediffuser.datagen.demo_results import SUMMARY, DemoResult, failure_path, summarize
from codediffuser.datagen.episode_format import EPISODES
from codediffuser.datagen.physics_store import forget_physics
from codediffuser.datagen.record import remove_folder
from codediffuser.datagen.shards.lease import LEASE_S, LeaseHeldError, LeaseLostError
from codediffuser.datagen.shards.plan import SHARD_SIZE, ShardPlan, make_plan
from codediffuser.datagen.shards.run import (
    ShardTask,
    WorkerDiedError,
    as_earlier,
    find_result,
    forget_result,
)
from codediffuser.errors import CodeDiffuserError, SetupError

MAX_ROUNDS = 5
"""How often shards that failed are given out again."""
MENDED = (LeaseLostError, WorkerDiedError)
"""Errors of ours that giving a shard out again mends."""

_log = logging.getLogger(__name__)


class Executor(Protocol):
    """Runs shards somewhere."""

    @property
    def workers(self) -> int:
        """How many shards run at a time."""

    def run(self, tasks: Sequence[ShardTask]) -> Iterator[tuple[ShardTask, Exception | None]]:
        """Run `run_shard` on every task; yield each when it ends, with what went wrong.

        A worker that dies is replaced; its task is yielded with an error and not tried again here.
        """


def collect_shards(
    run: Path,
    executor: Executor,
    options: CollectOptions | None = None,
    *,
    shard_size: int = SHARD_SIZE,
    lease_s: float = LEASE_S,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[DemoResult]:
    """Demonstrate every scene of a run in shards; write `demo_summary.json` last.

    The counterpart of `collect_demos` for executors: the same scenes, the same episodes.

    Args:
        run: Folder with `scenes/`, seen by all workers under the same path.
        executor: Where shards run.
        options: How scenes become episodes; None takes the usual.
        shard_size: Scenes of a shard.
        lease_s: After so long without a sign of life a worker is taken to be dead.
        sleep: Waits for others' leases.

    Raises:
        ConfigError: There are no scenes, or the run's plan is for something else.
        SetupError: Shards fail again and again; the message has the last reason.
    """
    started = time.monotonic()
    options = options or CollectOptions()
    plan = make_plan(run, options, shard_size)
    if options.overwrite:
        forget_all(run, plan)
    results = []
    waiting = []
    for shard in plan.shards:
        done = find_result(run, shard.id)
        if done is None or not done.whole:
            forget_result(run, shard.id)
            waiting.append(shard.id)
        else:
            results += as_earlier(done.results())
    yield from results
    for shard_id in _run_rounds(run, executor, waiting, lease_s, sleep):
        done = find_result(run, shard_id)
        assert done is not None
        results += done.results()
        yield from done.results()
    wall_s = time.monotonic() - started
    summarize(results, workers=executor.workers, wall_s=wall_s).save(run / SUMMARY)


def _run_rounds(
    run: Path,
    executor: Executor,
    shard_ids: Sequence[str],
    lease_s: float,
    sleep: Callable[[float], None],
) -> Iterator[str]:
    """Yield shards as they are done; those that fail are given out again in the next round."""
    waiting, reason = list(shard_ids), ""
    for _ in range(MAX_ROUNDS):
        failed, held_s = [], 0.0
        for task, error in executor.run([ShardTask(run, i, lease_s) for i in waiting]):
            # What counts is what lies on disk, whoever made it and whatever the worker said.
            if find_result(run, task.shard_id) is not None:
                yield task.shard_id
                continue
            reason = str(error)
            failed.append(task.shard_id)
            if isinstance(error, LeaseHeldError):
                held_s = max(held_s, error.left_s)
            elif isinstance(error, CodeDiffuserError) and not isinstance(error, MENDED):
                raise error
            bug = None if isinstance(error, CodeDiffuserError) else error
            _log.warning("shard %s is given out again: %s", task.shard_id, error, exc_info=bug)
        if not failed:
            return
        waiting = failed
        sleep(held_s)
    raise SetupError(
        f"{run}: shards {', '.join(waiting)} failed {MAX_ROUNDS} times, last: {reason}; what is "
        "done is kept, run the same command again to go on"
    )


def forget_all(run: Path, plan: ShardPlan) -> None:
    """Delete what was recorded of a plan, labels included."""
    for shard in plan.shards:
        forget_result(run, shard.id)
        for scene_id in shard.scene_ids:
            remove_folder(run / EPISODES / scene_id)
            failure_path(run, scene_id).unlink(missing_ok=True)
            forget_physics(run, scene_id)
