"""The index says what the files say, and nothing is lost with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codediffuser.labeling.index import INDEX, LABELING, load_index
from codediffuser.labeling.label import AttentionLabel, Provenance
from codediffuser.labeling.label_document import Saving
from codediffuser.labeling.marks import add_flag, add_review
from codediffuser.labeling.store import LABELS, load_document, save_labels

BY = Provenance(source="human", labeler="ada", tool_version="0")
AT = "2026-01-02T03:04:05Z"


def pair(place: str = "slot_0", **changes: object) -> list[AttentionLabel]:
    points = np.random.default_rng(len(place)).normal(size=(30, 3)).astype(np.float32)
    by = replace(BY, **changes)  # type: ignore[arg-type]
    return [
        AttentionLabel("pick", "battery", "battery_0", points, "battery_0", by),
        AttentionLabel("place", "slot", place, points + 1, None, by),
    ]


@pytest.fixture
def run(
    tmp_path: Path, write_synthetic_episode: Callable[..., tuple[Path, object, object]]
) -> Path:
    for name in ("000001", "000002", "000003"):
        write_synthetic_episode(tmp_path, name, num_steps=2)
    return tmp_path


def test_filters_follow_the_files(run: Path) -> None:
    assert load_index(run).ids("unlabeled") == ["000001", "000002", "000003"]
    first, second, third = sorted((run / "episodes").iterdir())
    save_labels(first, pair(), saved=Saving(by="ada", at=AT))
    save_labels(second, pair(confidence=0.4), saved=Saving(by="ada", at=AT))
    add_flag(third, "blurred", by="ada", at=AT)
    index = load_index(run)
    assert index.ids("unlabeled") == [] and index.ids("flagged") == ["000003"]
    assert index.ids("low confidence") == ["000002"]
    assert index.ids("to review") == ["000001", "000002"]
    assert index.ids("second opinion", "ada") == []
    assert index.ids("second opinion", "bob") == ["000001", "000002"]
    save_labels(first, pair("slot_1"), saved=Saving(by="bob", at=AT))
    assert load_index(run).ids("disagreeing") == ["000001"]
    add_review(first, "accept", "", by="eve", at=AT, expected_revision=2)
    index = load_index(run)
    assert index.ids("disagreeing") == [] and index.count("accepted") == 1


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_text("{")])
def test_a_lost_or_broken_index_is_made_again(
    run: Path, damage: Callable[[Path], object]
) -> None:  # fmt: skip
    save_labels(run / "episodes" / "000002", pair(), saved=Saving(by="ada", at=AT))
    before = load_index(run)
    damage(run / LABELING / INDEX)
    assert load_index(run) == before


def test_a_damaged_label_file_is_a_row_with_the_reason(run: Path) -> None:
    save_labels(run / "episodes" / "000001", pair())
    (run / "episodes" / "000001" / LABELS).write_text("{")
    row = load_index(run).rows[0]
    assert "not JSON" in row.problem and load_index(run).ids("damaged") == ["000001"]
    assert "000001" not in load_index(run).ids("unlabeled")


def test_flags_alone_are_no_labels(run: Path) -> None:
    folder = run / "episodes" / "000001"
    document = add_flag(folder, "blurred", by="ada", at=AT)
    assert document.revision == 0 and document.status == "unlabeled"
    saved = save_labels(folder, pair(), expected_revision=0)
    assert saved.revision == 1 and saved.document.flags == document.flags
    again = load_document(folder)
    assert again is not None and again.open_flags[0].reason == "blurred"
