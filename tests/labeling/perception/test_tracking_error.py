from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codediffuser.errors import EpisodeError
from codediffuser.labeling.perception.tracking_error import (
    TrackingError,
    judge_runs,
    phases,
    report,
)


def test_an_object_that_never_moves_is_never_carried() -> None:
    assert phases(np.zeros(5), np.full(5, 0.04)).tolist() == [0] * 5


def test_phases_begin_when_it_moves_and_when_the_fingers_open() -> None:
    moved_m = np.array([0.0, 0.0, 0.001, 0.01, 0.2, 0.3, 0.3, 0.3, 0.3])
    # Fingers still close while it moves, then open, and close again to push.
    opening_m = np.array([0.04, 0.03, 0.02, 0.015, 0.012, 0.0125, 0.015, 0.04, 0.0])
    assert phases(moved_m, opening_m).tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_an_object_that_is_never_let_go_is_carried_to_the_end() -> None:
    assert phases(np.array([0.0, 0.1, 0.2]), np.full(3, 0.01)).tolist() == [0, 1, 1]


def test_the_report_has_a_line_for_each_task_and_phase() -> None:
    one = TrackingError(
        "hang_mug", "000000", np.array([0.0, 0.001, 0.003]), np.array([0, 1, 1]),
        np.array([1.0, 0.9, 0.8], np.float32),
    )  # fmt: skip
    head, before, carried = report([one])
    assert head.split()[:4] == ["task", "phase", "frames", "median"]
    assert before.split()[:4] == ["hang_mug", "before", "1", "0.0"]
    assert carried.split()[:4] == ["hang_mug", "carried", "2", "2.0"]
    assert carried.split()[-1] == "0.85"


def test_a_run_without_episodes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="no episodes to judge"):
        list(judge_runs([tmp_path]))
