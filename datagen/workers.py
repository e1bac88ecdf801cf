"""Processes that work off a list of tasks and may die, hang or be killed without harm.

Each process has a pipe of its own and gets one task at a time: a killed process cannot take a
shared lock along, and it is known which task it had. Standard pools do neither.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Literal, TypeVar

from codediffuser.errors import CodeDiffuserError, SetupError

T = TypeVar("T")
R = TypeVar("R")

Fate = Literal["", "error", "died", "hung"]
"""How a task ended without an answer: an exception, the death of its process, or its time limit."""

START_TIMEOUT_S = 600.0
"""A process that is not ready after so long never will be."""

_log = logging.getLogger(__name__)
_spawn = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True)
class Outcome(Generic[T, R]):
    """What became of one task."""

    task: T
    value: R | None
    """The function's answer; None when there is an `error`."""
    error: str
    """Why there is no answer after all tries: trace, exit code or time limit."""
    tries: int
    fate: Fate = ""
    """What kind of error the last try ended with."""

    @property
    def reason(self) -> str:
        """The error in one line: of a trace the last."""
        return self.error.rsplit("\n", 1)[-1]


def run_tasks(
    function: Callable[[T], R],
    tasks: Iterable[T],
    *,
    workers: int = 1,
    timeout_s: float = 600.0,
    max_tries: int = 2,
    recycle_after: int = 100,
) -> Iterator[Outcome[T, R]]:
    """Apply `function` to every task in spawned processes; outcomes come as they are ready.

    A task is tried again in a fresh process after an exception, a death or a time-out. A
    `CodeDiffuserError` is the user's to mend, so it is raised here and ends everything.

    Args:
        function: Importable, since processes find it by name.
        tasks: Can be pickled.
        workers: How many processes, at least 1.
        timeout_s: After this time at one task a process is killed.
        max_tries: After as many failed tries a task's outcome is an error.
        recycle_after: Tasks after which a process is replaced, since renderers leak; 0 for never.

    Raises:
        SetupError: A process cannot even start.
    """
    crew: list[_Worker[T, R]] = []
    waiting = deque(_Job(task) for task in tasks)
    try:
        while waiting or any(w.job for w in crew):
            for worker in [w for w in crew if not w.job and 0 < recycle_after <= w.tasks_done]:
                _retire(crew, worker)
            _hand_out(crew, waiting, function, workers, timeout_s)
            for worker in _wait_for_news(crew):
                outcome = _hear(crew, worker, waiting, timeout_s, max_tries)
                if outcome is not None:
                    yield outcome
    finally:
        for worker in list(crew):
            _retire(crew, worker)


@dataclass(slots=True)
class _Job(Generic[T]):
    task: T
    tries: int = 0


@dataclass(frozen=True, slots=True)
class _Message:
    """What a process sends: that it is ready, or how a task ended."""

    value: Any = None
    error: str = ""
    user_error: CodeDiffuserError | None = None
    ready: bool = False


class _Worker(Generic[T, R]):
    """The parent's side of one process."""

    def __init__(self, function: Callable[[T], R]) -> None:
        self.pipe, far_end = _spawn.Pipe()
        self.process = _spawn.Process(target=_serve, args=(far_end, function), daemon=True)
        self.process.start()
        far_end.close()
        self.job: _Job[T] | None = None
        self.deadline = 0.0
        self.ready = False
        self.tasks_done = 0

    def give(self, job: _Job[T], timeout_s: float) -> None:
        self.job = job
        # Starting up, which loads the simulator, is not part of the task's time.
        self.deadline = time.monotonic() + (timeout_s if self.ready else START_TIMEOUT_S)
        # A process that died meanwhile is noticed by its closed pipe when its news is read.
        with contextlib.suppress(OSError):
            self.pipe.send(job.task)

    def message(self) -> _Message | None:
        """What came, or None when the process is gone or has overrun its time."""
        if not self.pipe.poll():
            return None
        try:
            received = self.pipe.recv()
        except (EOFError, OSError):
            return None
        return received if isinstance(received, _Message) else None


def _retire(crew: list[_Worker[T, R]], worker: _Worker[T, R]) -> None:
    crew.remove(worker)
    worker.pipe.close()
    # Idle processes end by themselves when their pipe closes; busy ones hold nothing of worth.
    if worker.job is not None:
        worker.process.kill()
    worker.process.join(timeout=5)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()


def _hand_out(
    crew: list[_Worker[T, R]],
    waiting: deque[_Job[T]],
    function: Callable[[T], R],
    workers: int,
    timeout_s: float,
) -> None:
    """Give a task to every idle process, starting processes up to their number."""
    idle = [w for w in crew if not w.job]
    while waiting and (idle or len(crew) < max(workers, 1)):
        if not idle:
            crew.append(_Worker(function))
            idle.append(crew[-1])
        idle.pop().give(waiting.popleft(), timeout_s)


def _wait_for_news(crew: list[_Worker[T, R]]) -> list[_Worker[T, R]]:
    """Sleep until a busy process has answered, died or overrun its time; return those."""
    busy = [w for w in crew if w.job]
    left_s = min(w.deadline for w in busy) - time.monotonic()
    heard = wait([w.pipe for w in busy], timeout=max(left_s, 0.0))
    now = time.monotonic()
    return [w for w in busy if w.pipe in heard or w.deadline <= now]


def _hear(
    crew: list[_Worker[T, R]],
    worker: _Worker[T, R],
    waiting: deque[_Job[T]],
    timeout_s: float,
    max_tries: int,
) -> Outcome[T, R] | None:
    """Take in one process's news: an outcome, or None when its task goes on or is tried again."""
    job, message = worker.job, worker.message()
    assert job is not None
    if message is not None and message.ready:
        worker.ready = True
        worker.deadline = time.monotonic() + timeout_s
        return None
    if message is not None and message.user_error is not None:
        raise message.user_error
    job.tries += 1
    fate: Fate
    if message is not None and not message.error:
        worker.job = None
        worker.tasks_done += 1
        return Outcome(job.task, message.value, "", job.tries)
    fate, error = ("error", message.error) if message else _fate(worker, timeout_s)
    _retire(crew, worker)
    if not worker.ready:
        raise SetupError(
            f"a worker process could not start ({error}); a script that starts workers needs "
            "its calls under `if __name__ == '__main__':`"
        )
    _log.warning("try %d of %d of %s failed: %s", job.tries, max_tries, job.task, error)
    if job.tries < max_tries:
        waiting.append(job)
        return None
    return Outcome(job.task, None, error, job.tries, fate)


def _fate(worker: _Worker[T, R], timeout_s: float) -> tuple[Fate, str]:
    """How a process that sent no answer ended."""
    if worker.deadline <= time.monotonic():
        return "hung", f"no answer within {timeout_s:.0f} s, killed"
    worker.process.join(timeout=5)
    code = worker.process.exitcode
    if code is not None and code < 0:
        return "died", f"process killed by {signal.Signals(-code).name}"
    return "died", f"process ended with exit code {code}"


def _serve(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """Body of a process: answer tasks until the pipe closes."""
    # Ctrl-C reaches the whole group; the parent decides what happens then.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        pipe.send(_Message(ready=True))
        while True:
            pipe.send(_answer(function, pipe.recv()))


def _answer(function: Callable[[Any], Any], task: Any) -> _Message:
    try:
        return _Message(value=function(task))
    except CodeDiffuserError as error:
        return _Message(user_error=error)
    except Exception:
        # Anything may go wrong in a task. Nothing is swallowed: the trace becomes the outcome's
        # error, and the parent logs it, replaces this process and tries the task once more.
        return _Message(error=traceback.format_exc().strip())


def _end_with_parent() -> None:
    """End at once when the parent is gone, so that a killed run leaves no process that writes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
