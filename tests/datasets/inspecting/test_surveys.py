"""What `inspect` says of runs and datasets is what lies in them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.cli import run as run_command
from codediffuser.datasets.inspecting.dataset_survey import dataset_motion, survey_dataset
from codediffuser.datasets.inspecting.html_report import render_html
from codediffuser.datasets.inspecting.run_survey import run_motion, survey_run
from codediffuser.datasets.inspecting.summary_text import human_bytes, summary_text
from codediffuser.datasets.inspecting.survey import resample, spread
from codediffuser.errors import EpisodeError


def test_a_run_is_counted(labelled_run: Callable[..., Path]) -> None:
    survey = survey_run(labelled_run())
    assert [e.frames for e in survey.episodes] == [5, 6, 7]
    assert survey.frames == 18 and survey.hours == pytest.approx(18 / 25 / 3600)
    assert survey.outcomes == {"success": 3}
    assert survey.count("kind") == {"no_slackness": 3}
    assert sorted(survey.instructions.values()) == [1, 2]
    assert survey.labels == {"pick battery": {"simulator": 3}, "place slot": {"simulator": 3}}
    assert survey.episodes[0].start_m == (0.0, 0.0) and survey.episodes[0].target_m == (0.02, 0.18)
    logs = sum(p.stat().st_size for p in survey.path.glob("episodes/*/episode.mcap"))
    assert survey.bytes_by_part["raw logs"] == logs


def test_a_dataset_tells_the_same_as_its_run(exported_run: Path) -> None:
    run, dataset = survey_run(exported_run), survey_dataset(exported_run / "lerobot")
    for a, b in zip(run.episodes, dataset.episodes, strict=True):
        assert (a.id, a.instruction, a.frames, a.hz) == (b.id, b.instruction, b.frames, b.hz)
        assert a.labels == b.labels
    shapes = {f.name: f.shape for f in dataset.features}
    assert shapes["observation.points"] == (200,) and shapes["action"] == (10,)


def test_motion_of_both_is_the_same(exported_run: Path) -> None:
    recorded = run_motion(exported_run, moments=5)
    exported = dataset_motion(exported_run / "lerobot", moments=5)
    assert exported is not None and exported.attention is not None
    assert np.array_equal(recorded.state, exported.state)
    assert np.array_equal(recorded.action, exported.action)
    assert exported.attention.shape == (3, 5, 2) and exported.attention.max() <= 40


def test_failures_and_damage_are_told(
    labelled_run: Callable[..., Path], write_battery_episode: Callable[..., Path]
) -> None:
    run = labelled_run()
    write_battery_episode(run, "000009", success=False)
    (run / "episodes" / "000001" / "labels.json").write_text("{")
    survey = survey_run(run)
    assert survey.outcomes == {"success": 2, "upright": 1}
    assert survey.unlabeled == 1
    assert len(survey.remarks) == 1 and "000001/labels.json" in survey.remarks[0]
    assert "not readable" in summary_text(survey)


def test_a_run_without_episodes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "episodes").mkdir()
    with pytest.raises(EpisodeError, match="no episodes yet; run `codediffuser demo"):
        survey_run(tmp_path)


def test_a_dataset_of_somebody_else_is_surveyed(exported_run: Path, tmp_path: Path) -> None:
    root = exported_run / "lerobot"
    (root / "meta" / "codediffuser.json").unlink()
    root.rename(tmp_path / "other")
    survey = survey_dataset(tmp_path / "other")
    assert survey.count("kind") == {"not recorded": 3}
    assert survey.count("code") == {"not recorded": 3}
    assert "kinds of instruction" not in summary_text(survey)


def test_the_report_loads_nothing_from_elsewhere_and_escapes_sentences(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    write_battery_episode(tmp_path, text="Pick <script>alert(1)</script> up.")
    page = render_html(survey_run(tmp_path), run_motion(tmp_path))
    assert not re.search(r"https?://|@import|url\(|<script", page)
    assert "Pick &lt;script&gt;" in page
    for title in ("Outcomes", "Episode lengths", "Starts and targets from above", "gripper"):
        assert title in page


def test_the_command_prints_a_summary_or_writes_what_is_asked(
    exported_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["inspect", str(exported_run)]) == 0
    assert f"run {exported_run}" in capsys.readouterr().out
    page = tmp_path / "page.html"
    assert run_command(["inspect", str(exported_run / "lerobot"), "--html", str(page)]) == 0
    assert capsys.readouterr().out.strip() == str(page)
    assert "Attended points per frame" in page.read_text()


def test_an_unknown_episode_is_refused_by_name(
    exported_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["inspect", str(exported_run), "--rerun", str(tmp_path / "x.rrd"), "--episodes", "7"]
    assert run_command(words) == 2
    assert "no episode '7'; it has 3, the first are: 000001" in capsys.readouterr().err


def test_a_damaged_dataset_is_refused(
    exported_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported_run / "lerobot" / "meta" / "info.json"
    info = json.loads(path.read_text())
    path.write_text(json.dumps({**info, "codebase_version": "v9"}))
    assert run_command(["inspect", str(path.parent.parent)]) == 2
    assert "expected codebase_version 'v3.0', got 'v9'" in capsys.readouterr().err


def test_resampling_takes_rows_that_exist() -> None:
    values = np.arange(7)[:, None]
    assert resample(values, 3)[:, 0].tolist() == [0, 3, 6]
    assert resample(values[:1], 3)[:, 0].tolist() == [0, 0, 0]
    assert spread(10, 3) == [0, 4, 9] and spread(2, 5) == [0, 1]


def test_sizes_are_read_by_people() -> None:
    assert [human_bytes(n) for n in (0, 999, 1500, 6.4e6, 2e9)] == [
        "0 B", "999 B", "1.5 kB", "6.4 MB", "2 GB",
    ]  # fmt: skip
