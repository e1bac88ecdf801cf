"""Agreement is a law of point sets; the report counts what is on disk and draws doubt."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codediffuser.errors import EpisodeError, ShapeError
from codediffuser.labeling.agreement import chamfer_m, point_iou
from codediffuser.labeling.auto import label_episode
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.report import report_text, write_report

seeds = st.integers(0, 1000)


def cloud(seed: int, count: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.02, (count, 3)).astype(np.float32)


@given(seeds, seeds)
def test_agreement_is_symmetric_and_perfect_with_oneself(a: int, b: int) -> None:
    first, second = cloud(a), cloud(b, 25)
    assert chamfer_m(first, second) == pytest.approx(chamfer_m(second, first))
    assert point_iou(first, second) == pytest.approx(point_iou(second, first))
    assert chamfer_m(first, first) == 0.0 and point_iou(first, first) == 1.0
    assert 0.0 <= point_iou(first, second) <= 1.0


def test_a_shift_is_the_chamfer_distance_of_points_far_apart() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    assert chamfer_m(points, points + np.float32([0, 0, 0.01])) == pytest.approx(0.01)
    assert point_iou(points, points + np.float32([0, 0, 0.01])) == 0.0


def test_half_of_a_cloud_has_an_iou_of_one_half() -> None:
    points = np.arange(60, dtype=np.float32).reshape(20, 3)
    assert point_iou(points, points[:10]) == pytest.approx(0.5)


def test_no_points_are_an_error() -> None:
    with pytest.raises(ShapeError, match="at least one point"):
        chamfer_m(cloud(0), np.zeros((0, 3), np.float32))


def work(desk: Desk, operator: str, places: list[str]) -> None:
    session = Session(desk, operator)
    session.filter = "all"
    session.start()
    for place in places:
        assert session.scene is not None
        session.clear()
        for name in ("battery_0", place):
            instance = session.scene.instance(name)
            assert instance is not None
            session.toggle(instance)
        desk.clock.now_s += 3.0  # type: ignore[attr-defined]
        session.submit()
        session.next()
    session.close()


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_the_report_compares_labelers_and_draws_where_they_disagree(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    for name in ("000001", "000002"):
        write_battery_episode(tmp_path, name, num_steps=3)
    desk = Desk(tmp_path, clock=Clock())
    work(desk, "ada", ["slot_0", "slot_0"])
    work(desk, "bob", ["slot_0", "slot_1"])
    desk.close()
    report, folder = write_report(tmp_path)
    assert (report.episodes, report.labeled, report.unlabeled) == (2, 2, 0)
    (pair,) = report.agreement
    assert (pair.first, pair.second, pair.targets) == ("ada", "bob", 4)
    assert pair.instance_accuracy == 0.75 and pair.mean_chamfer_m > 0.005
    assert [who.labels_per_minute for who in report.labelers] == [40.0, 40.0]
    assert report.disagreements == ("000002",)
    assert (folder / "000002.png").read_bytes()[:4] == b"\x89PNG"
    assert "same instance 75.0 %" in report_text(report)


def test_a_program_has_no_speed(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:  # fmt: skip
    label_episode(write_battery_episode(tmp_path, "000001", num_steps=3))
    report, _ = write_report(tmp_path)
    assert report.labelers[0].labels_per_minute is None and report.agreement == ()


def test_an_empty_run_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="no episodes to report on"):
        write_report(tmp_path)
