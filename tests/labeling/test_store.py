"""Labels on disk are whole, belong to their episode, and remember what they said."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codediffuser.errors import EpisodeError, LabelError, SchemaVersionError
from codediffuser.labeling.label import AttentionLabel, Provenance
from codediffuser.labeling.store import (
    LABELS,
    POINTS,
    has_labels,
    load_labels,
    points_sha256,
    save_labels,
)

BY = Provenance(source="human", labeler="Ada", tool_version="0", created_at="2026-01-02T03:04:05Z")


def points(seed: int, count: int = 30) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)


def pair(seed: int = 0) -> list[AttentionLabel]:
    return [
        AttentionLabel("pick", "battery", "battery_0", points(seed), "battery_0", BY),
        AttentionLabel("place", "slot", "slot_0", points(seed + 100), None, BY),
    ]


@pytest.fixture
def folder(
    tmp_path: Path, write_synthetic_episode: Callable[..., tuple[Path, object, object]]
) -> Path:
    return write_synthetic_episode(tmp_path, num_steps=2)[0]


def test_labels_come_back_as_they_were_saved(folder: Path) -> None:
    assert not has_labels(folder)
    saved = save_labels(folder, pair())
    loaded = load_labels(folder)
    assert has_labels(folder)
    assert loaded.revision == saved.revision == 1 and loaded.episode_id == "000042"
    for label, found in zip(pair(), loaded.labels, strict=True):
        assert np.array_equal(label.points_world, found.points_world)
        assert found.points_world.dtype == np.float32
        for field in ("role", "category", "instance_id", "follows", "provenance"):
            assert getattr(found, field) == getattr(label, field)
    assert loaded["place"].instance_id == "slot_0"


def test_roles_are_kept_in_their_order(folder: Path) -> None:
    save_labels(folder, pair()[::-1])
    assert [label.role for label in load_labels(folder).labels] == ["pick", "place"]


def test_same_labels_give_the_same_bytes(
    tmp_path: Path, write_synthetic_episode: Callable[..., tuple[Path, object, object]]
) -> None:
    contents = []
    for run in ("a", "b"):
        folder = write_synthetic_episode(tmp_path / run, num_steps=2)[0]
        save_labels(folder, pair())
        contents.append(((folder / LABELS).read_bytes(), (folder / POINTS).read_bytes()))
    assert contents[0] == contents[1]


def test_saving_the_same_again_adds_no_revision(folder: Path) -> None:
    save_labels(folder, pair())
    before = (folder / LABELS).read_bytes()
    assert save_labels(folder, pair()).revision == 1
    assert (folder / LABELS).read_bytes() == before


def test_earlier_revisions_stay_with_their_points(folder: Path) -> None:
    for seed in range(3):
        save_labels(folder, pair(seed), expected_revision=seed)
    document = load_labels(folder).document
    assert document.revision == 3 and [r.revision for r in document.history] == [1, 2]
    with np.load(folder / POINTS) as arrays:
        for seed, revision in enumerate(document.history):
            assert np.array_equal(arrays[revision.labels[0].points_sha256], points(seed))


def test_a_writer_that_saw_an_older_revision_is_refused(folder: Path) -> None:
    save_labels(folder, pair(0), expected_revision=0)
    save_labels(folder, pair(1), expected_revision=1)
    with pytest.raises(LabelError, match="revision 2 is there, 1 was expected"):
        save_labels(folder, pair(2), expected_revision=1)
    assert np.array_equal(load_labels(folder)["pick"].points_world, points(1))


def test_json_is_versioned_and_names_the_points(folder: Path) -> None:
    save_labels(folder, pair())
    raw = json.loads((folder / LABELS).read_text())
    assert raw["schema"] == "codediffuser.labels/2"
    assert raw["labels"][0]["points_sha256"] == points_sha256(points(0))
    assert raw["labels"][0]["num_points"] == 30


def test_no_labels_is_an_error_with_the_remedy(folder: Path) -> None:
    with pytest.raises(LabelError, match=r"no labels; run `codediffuser label RUN --auto`"):
        load_labels(folder)


def test_no_episode_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="no episode here"):
        save_labels(tmp_path, pair())


def test_labels_of_another_episode_are_refused(
    folder: Path, write_synthetic_episode: Callable[..., tuple[Path, object, object]]
) -> None:
    other = write_synthetic_episode(folder.parent.parent, "000007", num_steps=3)[0]
    save_labels(other, pair())
    for name in (LABELS, POINTS):
        (folder / name).write_bytes((other / name).read_bytes())
    with pytest.raises(LabelError, match=r"belong to episode '000007'.*holds '000042'"):
        load_labels(folder)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / POINTS).unlink(), "no such file, but labels.json names points"),
        (lambda f: (f / POINTS).write_bytes(b"PK\x03\x04nonsense"), "damaged"),
        (lambda f: (f / POINTS).write_bytes((f / POINTS).read_bytes()[:200]), "damaged"),
        (lambda f: np.savez(f / POINTS, other=points(0)), "lacks the points"),
        (lambda f: np.savez(f / POINTS, **{points_sha256(points(s)): points(9) for s in (0, 100)}),
         "not what they were"),
    ],
)  # fmt: skip
def test_damaged_points_are_an_error(
    folder: Path, damage: Callable[[Path], object], message: str
) -> None:
    save_labels(folder, pair())
    damage(folder)
    with pytest.raises(LabelError, match=f"{message}.*codediffuser label RUN --auto"):
        load_labels(folder)


def test_labels_of_a_newer_version_are_refused_by_name(folder: Path) -> None:
    save_labels(folder, pair())
    path = folder / LABELS
    path.write_text(path.read_text().replace("codediffuser.labels/2", "codediffuser.labels/9"))
    with pytest.raises(SchemaVersionError, match=r"codediffuser\.labels/9"):
        load_labels(folder)


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (pair()[:1], r"one label for each of .* got \('pick',\)"),
        ([pair()[0], pair()[0]], r"got \('pick', 'pick'\)"),
        ([pair()[0], replace(pair()[1], points_world=np.zeros((0, 3), np.float32))], "no points"),
        ([pair()[0], replace(pair()[1], points_world=np.zeros((4, 2), np.float32))], r"\(N, 3\)"),
        ([pair()[0], replace(pair()[1], points_world=np.full((4, 3), np.nan))], "not-a-number"),
    ],
)
def test_incomplete_labels_are_refused_and_nothing_is_written(
    folder: Path, labels: list[AttentionLabel], message: str
) -> None:
    with pytest.raises(LabelError, match=message):
        save_labels(folder, labels)
    assert not has_labels(folder)


def test_points_that_an_interrupted_save_left_do_no_harm(folder: Path) -> None:
    """The state between the two writes: new points beside the older JSON."""
    save_labels(folder, pair(0))
    older = (folder / LABELS).read_bytes()
    save_labels(folder, pair(1))
    (folder / LABELS).write_bytes(older)
    assert np.array_equal(load_labels(folder)["pick"].points_world, points(0))
    assert save_labels(folder, pair(2), expected_revision=1).revision == 2


def test_a_save_killed_at_any_moment_leaves_readable_labels(folder: Path, tmp_path: Path) -> None:
    save_labels(folder, pair(0))
    code = f"""
        import sys
        import numpy as np
        from pathlib import Path
        from codediffuser.labeling.label import AttentionLabel, Provenance
        from codediffuser.labeling.store import save_labels
        by = Provenance(source="human", labeler="x", tool_version="0")
        print("ready", flush=True)
        for n in range(10_000):
            p = np.full((500, 3), n, np.float32)
            save_labels(Path({str(folder)!r}), [
                AttentionLabel("pick", "b", "b", p, "b", by),
                AttentionLabel("place", "s", "s", p + 0.5, None, by),
            ])
    """
    for delay_s in (0.02, 0.05, 0.11):
        child = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None and child.stdout.readline() == "ready\n"
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(timeout=delay_s)
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        child.stdout.close()
        found = load_labels(folder)
        assert len(found.labels) == 2
        # What the killed process held (a lock) does not stand in the way.
        save_labels(folder, pair(int(delay_s * 100)), expected_revision=found.revision)
    assert not list(folder.glob(".partial-*"))


def test_labels_of_version_1_are_read_and_saved_as_the_newest(folder: Path) -> None:
    save_labels(folder, pair(0))
    save_labels(folder, pair(1))
    raw = json.loads((folder / LABELS).read_text())
    raw["schema"] = "codediffuser.labels/1"
    for entry in (raw, *raw["history"]):
        del entry["saved"]
    del raw["flags"], raw["reviews"]
    (folder / LABELS).write_text(json.dumps(raw))
    old = load_labels(folder)
    assert old.revision == 2 and old.document.flags == () and old.document.history[0].saved is None
    save_labels(folder, pair(2), expected_revision=2)
    assert json.loads((folder / LABELS).read_text())["schema"] == "codediffuser.labels/2"
    assert [r.revision for r in load_labels(folder).document.history] == [1, 2]


def test_labels_that_differ_only_in_their_time_are_the_same(folder: Path) -> None:
    save_labels(folder, pair())
    later = [replace(x, provenance=replace(BY, created_at="2027-01-01")) for x in pair()]
    assert save_labels(folder, later).revision == 1
    other = [replace(x, provenance=replace(BY, labeler="Bob")) for x in pair()]
    assert save_labels(folder, other).revision == 2
