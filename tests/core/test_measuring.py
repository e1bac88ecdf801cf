"""Measured work runs in a process of its own."""

from __future__ import annotations

import os
import time

import pytest

from codediffuser.errors import DatasetError
from codediffuser.measuring import group_memory_mb, take_turn


def test_a_turn_tells_time_and_memory_of_the_work_alone() -> None:
    turn = take_turn(time.sleep, (0.3,), ())
    assert 0.3 <= turn.wall_s < 2 and turn.cpu_s < 0.3
    assert 5 < turn.peak_mb < 2000


def test_work_that_fails_is_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(DatasetError, match="ended without a result"):
        take_turn(time.sleep, ("soon",), ())
    assert "TypeError" in capfd.readouterr().err


def test_work_starts_processes_as_a_program_of_its_own_does() -> None:
    code = "import multiprocessing as m; assert m.get_start_method(allow_none=True) is None"
    take_turn(exec, (code,), ())


def test_a_group_without_processes_takes_no_memory() -> None:
    assert group_memory_mb(os.getpgrp()) > 5 and group_memory_mb(2**22 + 1) == 0
