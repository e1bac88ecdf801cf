"""The command that runs stock tools: what counts as working, and what is told of the rest."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from codediffuser.datasets.exporting import stock_tools
from codediffuser.datasets.exporting.stock_tools import Call, Options, run_tools


@pytest.mark.slow
def test_libraries_open_exports_and_recordings(
    labelled_run: Callable[..., Path], tmp_path: Path
) -> None:
    options = Options(run=labelled_run(3), only=("load_dataset", "AnyReader", "mcap_ros2"))
    outcomes = list(run_tools(options, tmp_path / "tools"))
    assert [(o.profile, o.works, o.result) for o in outcomes] == [
        ("portable", True, "3 episodes"),
        ("masked-rgb", True, "3 episodes"),
        ("pointcloud", True, "3 episodes"),
        ("rosbag2", True, outcomes[3].result),
        ("rosbag2", True, outcomes[4].result),
    ]
    assert all("messages of" in outcome.result for outcome in outcomes[3:])


@pytest.mark.parametrize(
    ("code", "works", "result"),
    [
        ("print('made')", True, "made"),
        ("print('nothing')", False, "ValueError: expected 'made', it said 'nothing'"),
        ("raise SystemExit('no such dataset')", False, "no such dataset"),
        (
            f"import sys; print('made'); sys.exit('{stock_tools.ABORTED}')",
            True,
            "made; aborted while Python ended",
        ),
    ],
)
def test_a_command_works_when_it_made_what_it_should(
    code: str, works: bool, result: str, tmp_path: Path
) -> None:
    call = Call("any", [sys.executable, "-c", code], lambda out: stock_tools._said(out, "made"))
    outcome = stock_tools._run(call, "portable", {}, tmp_path)
    assert (outcome.works, outcome.result) == (works, result)
    assert str(outcome).startswith("works" if works else "FAILS")
