"""What measurements share: their command line, and turns in processes of their own."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from codediffuser.errors import DatasetError

Options = TypeVar("Options")
TURN_TIMEOUT_S = 3600.0
"""A longer turn is taken for hung."""
WATCH_EVERY_S = 0.1
"""How often memory is looked at."""


@dataclass(frozen=True, slots=True)
class Turn:
    """What one turn took."""

    wall_s: float
    cpu_s: float
    """Of all processes."""
    peak_mb: float = 0.0
    """Most memory of all processes together, libraries included; pages that several share count
    once."""


def print_measured(options: type[Options], measure: Callable[[Options, Path], object]) -> None:
    """Parse options from the command line, measure, and print what came out.

    Args:
        options: A dataclass; its fields are the options, their docstrings the help.
        measure: Gets the options and an empty folder, which is deleted afterwards. What it returns
            says itself as text.
    """
    import tyro

    chosen = tyro.cli(options)
    with tempfile.TemporaryDirectory(prefix="codediffuser-") as scratch:
        sys.stdout.write(f"{measure(chosen, Path(scratch))}\n")


def take_turn(
    work: Callable[..., None], arguments: Sequence[Any], libraries: Sequence[str]
) -> Turn:
    """Do some work in a new process and see what it takes.

    Args:
        work: What can be sent to a process. Its exceptions end the process with their trace.
        arguments: Of the work.
        libraries: Modules that are imported before the clock starts.

    Raises:
        DatasetError: The process ended without a result, or hung.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_turn, args=(sender, work, arguments, libraries))
    process.start()
    pid = process.pid
    assert pid is not None
    sender.close()
    until, peak_mb = time.monotonic() + TURN_TIMEOUT_S, 0.0
    try:
        while not receiver.poll(WATCH_EVERY_S):
            peak_mb = max(peak_mb, group_memory_mb(pid))
            if time.monotonic() > until:
                raise DatasetError(f"a turn did not end within {TURN_TIMEOUT_S:.0f} s")
        turn: Turn = receiver.recv()
        process.join()
    except EOFError:
        raise DatasetError("a turn ended without a result; see its message above") from None
    finally:
        # And all that it has started: one of those may be what hangs.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)
    return replace(turn, peak_mb=peak_mb)


def _turn(
    pipe: Connection, work: Callable[..., None], arguments: Sequence[Any], libraries: Sequence[str]
) -> None:
    os.setpgrp()
    # Processes that the work starts are to be started as in a program of its own: a spawned process
    # would spawn its own, too, and each would load all libraries anew.
    multiprocessing.set_start_method(None, force=True)
    for name in libraries:
        importlib.import_module(name)
    started, cpu_s = time.perf_counter(), _cpu_s()
    work(*arguments)
    pipe.send(Turn(time.perf_counter() - started, _cpu_s() - cpu_s))


def _cpu_s() -> float:
    used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def group_memory_mb(group: int) -> float:
    """Memory of all processes of a group together; pages that several share count once.

    Linux alone tells this; elsewhere it is 0.
    """
    total_kb = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            # Behind the name in brackets: state, parent, group.
            if int(stat.read_text().rpartition(")")[2].split()[2]) != group:
                continue
            rollup = stat.with_name("smaps_rollup").read_text()
        except (OSError, IndexError):  # it has just ended
            continue
        total_kb += int(rollup.split("\nPss:")[1].split()[0])
    return total_kb / 1024
