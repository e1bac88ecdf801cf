"""Every task has an outcome, whatever happens to the process that works on it.

`eval` stands for the function: a task is then a line of Python that runs in the process.
"""

import os
import signal
import subprocess
import sys
import time

import pytest

from codediffuser.datagen.workers import run_tasks
from codediffuser.errors import PlacementError, SetupError

DIE = "__import__('os')._exit(3)"
SEGFAULT = "__import__('os').kill(__import__('os').getpid(), 11)"
SLEEP = "__import__('time').sleep(60)"
USER_ERROR = (
    "(_ for _ in ()).throw(__import__('codediffuser.errors').errors.PlacementError('full'))"
)


def outcomes(tasks, **options):
    return {o.task: o for o in run_tasks(eval, tasks, **options)}


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_is_answered_once(workers):
    done = outcomes([f"{i} * {i}" for i in range(7)], workers=workers)
    assert {o.task: o.value for o in done.values()} == {f"{i} * {i}": i * i for i in range(7)}
    assert all((o.error, o.tries) == ("", 1) for o in done.values())


def test_no_tasks_start_no_process():
    assert list(run_tasks(eval, [])) == []


def test_an_exception_is_told_with_its_trace_and_harms_nobody_else():
    done = outcomes(["1", "1 / 0", "2"])
    assert "ZeroDivisionError" in done["1 / 0"].error
    assert done["1 / 0"].tries == 2
    assert (done["1"].value, done["2"].value) == (1, 2)


@pytest.mark.parametrize(("task", "told"), [(DIE, "exit code 3"), (SEGFAULT, "SIGSEGV")])
def test_a_process_that_dies_is_replaced(task, told):
    done = outcomes(["1", task, "2"], max_tries=2)
    assert told in done[task].error
    assert done[task].tries == 2
    assert (done["1"].value, done["2"].value) == (1, 2)


def test_a_task_that_works_the_second_time_is_done(tmp_path):
    marker = tmp_path / "tried"
    tried = f"__import__('os').path.exists({str(marker)!r})"
    task = f"1 if {tried} else (open({str(marker)!r}, 'w'), {DIE})"
    done = outcomes([task])
    assert (done[task].value, done[task].tries) == (1, 2)


def test_a_process_that_hangs_is_killed_and_replaced():
    started = time.monotonic()
    done = outcomes([SLEEP, "1"], timeout_s=0.5, max_tries=1)
    assert "no answer within" in done[SLEEP].error
    assert done["1"].value == 1
    assert time.monotonic() - started < 20


def test_an_error_of_the_user_ends_everything():
    with pytest.raises(PlacementError, match="full"):
        list(run_tasks(eval, [USER_ERROR, "1"]))


def test_processes_are_recycled():
    pids = [o.value for o in run_tasks(eval, ["__import__('os').getpid()"] * 3, recycle_after=1)]
    assert len(set(pids)) == 3


def test_leaving_early_ends_the_processes():
    work = run_tasks(eval, ["__import__('os').getpid()", SLEEP])
    pid = next(work).value
    work.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_process_that_cannot_start_is_a_setup_error(tmp_path, monkeypatch):
    module = tmp_path / "only_here.py"
    module.write_text("def work(task):\n    return task\n")
    monkeypatch.syspath_prepend(tmp_path)
    from only_here import work

    module.unlink()
    with pytest.raises(SetupError, match="could not start"):
        list(run_tasks(work, [1]))


def test_processes_end_when_their_parent_is_killed(tmp_path):
    pid_file = tmp_path / "pid"
    task = f"(open({str(pid_file)!r}, 'w').write(str(__import__('os').getpid())), {SLEEP})"
    script = tmp_path / "parent.py"
    script.write_text(
        "from codediffuser.datagen.workers import run_tasks\n"
        f"if __name__ == '__main__':\n    list(run_tasks(eval, [{task!r}]))\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)])
    _wait_until(lambda: pid_file.exists() and pid_file.read_text())
    child = int(pid_file.read_text())
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    _wait_until(lambda: not _alive(child))


def _alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def _wait_until(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
