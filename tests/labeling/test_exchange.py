"""Labels travel as one file and come back as they were; two histories are never mixed up."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.errors import ConfigError, SchemaVersionError
from codediffuser.labeling.exchange import export_labels, import_labels
from codediffuser.labeling.label import AttentionLabel, Provenance
from codediffuser.labeling.label_document import Saving
from codediffuser.labeling.marks import add_flag
from codediffuser.labeling.store import LABELS, POINTS, load_labels, save_labels

BY = Provenance(source="human", labeler="ada", tool_version="0")
SAVED = Saving(by="ada", at="2026-01-02T03:04:05Z", seconds=3.5)


def pair(seed: int) -> list[AttentionLabel]:
    points = np.random.default_rng(seed).normal(size=(30, 3)).astype(np.float32)
    return [
        AttentionLabel("pick", "battery", "battery_0", points, "battery_0", BY),
        AttentionLabel("place", "slot", f"slot_{seed}", points + 1, None, BY),
    ]


@pytest.fixture
def runs(
    tmp_path: Path, write_synthetic_episode: Callable[..., tuple[Path, object, object]]
) -> tuple[Path, Path]:
    """Two copies of a run with three episodes."""
    for name in ("000001", "000002", "000003"):
        write_synthetic_episode(tmp_path / "a", name, num_steps=2)
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    return tmp_path / "a", tmp_path / "b"


def folder(run: Path, name: str = "000001") -> Path:
    return run / "episodes" / name


def test_a_round_trip_gives_the_same_bytes(runs: tuple[Path, Path], tmp_path: Path) -> None:
    here, there = runs
    for seed in range(2):
        save_labels(folder(here), pair(seed), saved=SAVED)
    add_flag(folder(here, "000003"), "blurred", by="ada", at=SAVED.at)
    assert export_labels(here, tmp_path / "x.jsonl") == 2
    assert [r.outcome for r in import_labels(there, tmp_path / "x.jsonl")] == ["new", "new"]
    for name in (LABELS, POINTS):
        assert (folder(here) / name).read_bytes() == (folder(there) / name).read_bytes()
    assert [r.outcome for r in import_labels(there, tmp_path / "x.jsonl")] == ["unchanged"] * 2
    assert load_labels(folder(there)).document.history[0].labels[1].instance_id == "slot_0"


def test_the_side_that_continues_the_other_wins(runs: tuple[Path, Path], tmp_path: Path) -> None:
    here, there = runs
    old, new = tmp_path / "old.jsonl", tmp_path / "new.jsonl"
    save_labels(folder(here), pair(0))
    export_labels(here, old)
    list(import_labels(there, old))
    save_labels(folder(here), pair(1))
    export_labels(here, new)
    assert [r.outcome for r in import_labels(there, new)] == ["newer"]
    assert [r.outcome for r in import_labels(here, old)] == ["older"]
    assert load_labels(folder(here)).revision == load_labels(folder(there)).revision == 2


def test_two_histories_are_a_conflict_and_nothing_changes(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    here, there = runs
    save_labels(folder(here), pair(0))
    save_labels(folder(there), pair(1))
    export_labels(here, tmp_path / "x.jsonl")
    before = (folder(there) / LABELS).read_bytes()
    assert [r.outcome for r in import_labels(there, tmp_path / "x.jsonl")] == ["conflict"]
    assert (folder(there) / LABELS).read_bytes() == before


def test_episodes_are_known_by_content_not_by_name(runs: tuple[Path, Path], tmp_path: Path) -> None:
    here, there = runs
    save_labels(folder(here), pair(0))
    export_labels(here, tmp_path / "x.jsonl")
    shutil.rmtree(folder(there))
    (result,) = import_labels(there, tmp_path / "x.jsonl")
    assert result.outcome == "error" and "no episode" in result.message


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda lines: lines[:-1], ConfigError, "expected 1 episodes, found 0"),
        (lambda lines: [], ConfigError, "not JSON"),
        (lambda lines: [lines[0].replace("/1", "/7"), lines[1]], SchemaVersionError, "newer"),
    ],
)
def test_a_file_that_is_not_whole_is_refused(
    runs: tuple[Path, Path], tmp_path: Path, change: Callable[[list[str]], list[str]],
    error: type[Exception], message: str,
) -> None:  # fmt: skip
    save_labels(folder(runs[0]), pair(0))
    path = tmp_path / "x.jsonl"
    export_labels(runs[0], path)
    path.write_text("\n".join(change(path.read_text().splitlines())))
    with pytest.raises(error, match=message):
        list(import_labels(runs[1], path))


def test_points_that_changed_on_the_way_are_refused(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    save_labels(folder(runs[0]), pair(0))
    path = tmp_path / "x.jsonl"
    export_labels(runs[0], path)
    head, line = path.read_text().splitlines()
    raw = json.loads(line)
    name = min(raw["points"])
    raw["points"][name] = "AAAA" + raw["points"][name][4:]
    path.write_text(f"{head}\n{json.dumps(raw)}\n")
    (result,) = import_labels(runs[1], path)
    assert result.outcome == "error" and "not what they were" in result.message
