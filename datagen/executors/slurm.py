"""Shards as Slurm jobs, through submitit: one job a shard.

The run folder must lie on a file system that all nodes share.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from codediffuser.datagen.shards.run import ShardTask, WorkerDiedError, run_shard
from codediffuser.errors import CodeDiffuserError, SetupError

POLL_S = 1.0


@dataclass(frozen=True, slots=True)
class SlurmOptions:
    """What each job asks for."""

    partition: str | None = None
    minutes: int = 120
    """Limit of a job; one that overruns it is given out again and goes on where it was."""
    memory_gb: float = 8.0
    cluster: Literal["slurm", "local", "debug"] = "slurm"
    """`local` runs jobs as processes of this machine, `debug` in this process, to try things."""


class ShardCall:
    """What a job runs; Slurm may stop it and start it again."""

    def __call__(self, task: ShardTask) -> CodeDiffuserError | None:
        """Run a shard; an error of the user's is answered, so that it arrives as what it is."""
        try:
            run_shard(task)
        except CodeDiffuserError as error:
            return error
        return None

    def checkpoint(self, task: ShardTask) -> Any:
        """Told that the job is about to be stopped: the same call later goes on."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, task)


class SlurmExecutor:
    """Runs shards as jobs.

    Args:
        logs: Folder for submitit's scripts and logs, on the shared file system.
        workers: How many jobs at a time.
        options: What each asks for.

    Raises:
        SetupError: submitit is not installed, or there is no Slurm here.
    """

    def __init__(self, logs: Path, workers: int = 1, options: SlurmOptions | None = None) -> None:
        self.workers = max(workers, 1)
        self._submitit = _import_submitit()
        options = options or SlurmOptions()
        try:
            self._executor = self._submitit.AutoExecutor(folder=logs, cluster=options.cluster)
        except RuntimeError as error:
            raise SetupError(
                f"no Slurm on this machine ({error}); submit from a login node, or try "
                "--slurm-cluster local"
            ) from None
        # One CPU simulates, another draws.
        self._executor.update_parameters(
            name="codediffuser-demo", timeout_min=options.minutes, cpus_per_task=2,
            mem_gb=options.memory_gb,
        )  # fmt: skip
        if options.partition is not None:
            self._executor.update_parameters(slurm_partition=options.partition)

    def run(self, tasks: Sequence[ShardTask]) -> Iterator[tuple[ShardTask, Exception | None]]:
        """Run every task; yield each when it ends, with what went wrong."""
        waiting = deque(tasks)
        running: list[tuple[Any, ShardTask]] = []
        try:
            while waiting or running:
                while waiting and len(running) < self.workers:
                    task = waiting.popleft()
                    running.append((self._executor.submit(ShardCall(), task), task))
                ended = [pair for pair in running if pair[0].done()]
                running = [pair for pair in running if pair not in ended]
                for job, task in ended:
                    yield task, self._error(job)
                if not ended:
                    time.sleep(POLL_S)
        finally:
            for job, _ in running:
                job.cancel()

    def _error(self, job: Any) -> Exception | None:
        try:
            answer: Exception | None = job.result()
        except (self._submitit.core.utils.UncompletedJobError, OSError) as error:
            return WorkerDiedError(f"job {job.job_id}: {str(error).strip().splitlines()[0]}")
        return answer


def _import_submitit() -> Any:
    try:
        import submitit
    except ImportError:
        raise SetupError(
            "the slurm executor needs submitit, which is not installed: "
            "pip install 'codediffuser[slurm]'"
        ) from None
    return submitit
