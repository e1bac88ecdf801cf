"""Validation finds each kind of damage, says where, and finds nothing in what is whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from codediffuser.datasets.export_meta import DOCUMENT, INFO, STATS
from codediffuser.datasets.features import ACTION, POINTS
from codediffuser.datasets.validate import report, validate
from codediffuser.errors import DatasetError, SchemaVersionError
from codediffuser.labeling.store import LABELS, load_labels, save_labels
from codediffuser.labeling.store import POINTS as POINTS_FILE

DATA = "data/chunk-000/file-000.parquet"


def whats(path: Path) -> str:
    return "\n".join(f"{f.where}: {f.what}" for f in validate(path))


def edit_column(root: Path, key: str, change: Callable[[np.ndarray], None]) -> None:
    """Rewrite one column of the data file; `change` works on the (T, D) array in place."""
    table = pq.read_table(root / DATA)
    i = table.schema.get_field_index(key)
    values = np.array(table.column(i).to_pylist())
    change(values)
    column = pa.array(values.tolist(), table.schema.field(i).type)
    pq.write_table(table.set_column(i, table.schema.field(i), column), root / DATA)


def test_nothing_is_wrong_with_a_fresh_run(exported_run: Path) -> None:
    for path in (exported_run, exported_run / "lerobot", exported_run / "episodes" / "000001"):
        findings = list(validate(path))
        assert findings == []
        assert report(path, findings) == f"{path}: nothing wrong"


def test_a_run_before_labels_and_export_is_fine(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    write_battery_episode(tmp_path)
    assert not list(validate(tmp_path))


def test_nothing_to_validate_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="nothing to validate; expected a run"):
        list(validate(tmp_path))


def test_the_report_has_a_remedy_for_each_finding(exported_run: Path) -> None:
    (exported_run / "episodes" / "000001" / LABELS).unlink()
    findings = list(validate(exported_run))
    text = report(exported_run, findings)
    assert text.splitlines()[0] == f"{exported_run}: {len(findings)} findings"
    assert text.count("    -> ") == len(findings) == 2
    assert "no labels, though other episodes have some" in text
    assert "labels of episode 000001 changed" in text


def test_damaged_episodes_and_labels_are_found(exported_run: Path) -> None:
    episodes = exported_run / "episodes"
    log = episodes / "000001" / "episode.mcap"
    log.write_bytes(log.read_bytes()[:-1])
    (episodes / "000002" / POINTS_FILE).write_bytes(b"no zip")
    found = whats(exported_run)
    assert "000001/episode.mcap: expected" in found
    assert "000002/labels.json" in found and "damaged" in found


def test_labels_that_fit_nothing_are_found(exported_run: Path) -> None:
    folder = exported_run / "episodes" / "000001"
    pick, place = load_labels(folder).labels
    away = replace(pick, points_world=pick.points_world + 1)
    save_labels(folder, [away, replace(place, instance_id="slot_9")])
    found = whats(folder)
    assert "pick label: its points lie" in found
    assert "place label: 'slot_9' is not in the scene; it has: slot_0, slot_1" in found
    assert "is not the scene's target 'slot_0'" in found
    save_labels(folder, [replace(pick, follows="crate"), place])
    assert "follows 'crate', which does not move" in whats(folder)


def test_an_export_older_than_its_run_is_found(
    exported_run: Path, write_battery_episode: Callable[..., Path]
) -> None:
    from codediffuser.labeling.auto import label_episode

    label_episode(write_battery_episode(exported_run, "000008"))
    folder = exported_run / "episodes" / "000001"
    pick, place = load_labels(folder).labels
    save_labels(folder, [pick, replace(place, points_world=place.points_world[1:])])
    found = whats(exported_run)
    assert "episode 000008 is not in the dataset" in found
    assert "labels of episode 000001 changed" in found


@pytest.mark.parametrize(
    ("key", "change", "message"),
    [
        (POINTS, lambda v: v.__setitem__((7, 3), np.nan), f"{POINTS} of frame 2 is not finite"),
        (POINTS, lambda v: v.__setitem__((7, 0), 9.0), "points of frame 2 lie more than 3.0 m"),
        (POINTS, lambda v: v.__setitem__((7, 3), 2.0), "attention outside 0 to 1"),
        (POINTS, lambda v: v.__setitem__((7, slice(3, None, 5)), 0.0),
         "attention_pick: no attended point in 1 frames, first 2"),
        (ACTION, lambda v: v.__setitem__((7, 1), v[7, 1] + 0.5), f"{ACTION} jumps at frame 2"),
        (ACTION, lambda v: v.__setitem__((7, slice(3, 9)), [0, -1, 0, 1, 0, 0]), "rad/s"),
        (ACTION, lambda v: v.__setitem__((7, slice(3, 9)), 0), "rot6d"),
        ("timestamp", lambda v: v.__setitem__(7, 9.0), "timestamp of frame 2: expected 0.08"),
        ("frame_index", lambda v: v.__setitem__(7, 1), "frame_index of frame 2"),
        ("episode_index", lambda v: v.__setitem__(7, 0), "episode_index of frame 2"),
        ("index", lambda v: v.__setitem__(7, 8), "frames are out of order"),
    ],
)  # fmt: skip
def test_wrong_values_are_found_where_they_are(
    exported_run: Path, key: str, change: Callable[[np.ndarray], None], message: str
) -> None:
    root = exported_run / "lerobot"
    edit_column(root, key, change)
    assert message in whats(root)


def test_wrong_statistics_are_found(exported_run: Path) -> None:
    path = exported_run / "lerobot" / STATS
    stats = json.loads(path.read_text())
    stats[POINTS]["mean"][3] += 0.01
    stats[ACTION]["count"] = [17]
    path.write_text(json.dumps(stats))
    found = whats(exported_run / "lerobot")
    assert f"{POINTS}/mean is not that of the data" in found
    assert f"{ACTION}/count is not that of the data" in found
    path.write_text("{")
    assert "stats.json: not readable" in whats(exported_run / "lerobot")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("total_frames", 19, "total_frames is 19, the episodes have 18"),
        ("total_episodes", 1, "total_episodes is 1, the episodes have 3"),
        ("total_tasks", 7, "total_tasks is 7, the episodes have 2"),
    ],
)
def test_wrong_counts_are_found(exported_run: Path, key: str, value: int, message: str) -> None:
    path = exported_run / "lerobot" / INFO
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    assert message in whats(exported_run / "lerobot")


def test_a_missing_feature_and_a_wrong_shape_are_found(exported_run: Path) -> None:
    path = exported_run / "lerobot" / INFO
    info = json.loads(path.read_text())
    info["features"][ACTION]["shape"] = [7]
    path.write_text(json.dumps(info))
    told = f"{ACTION}: expected shape [10] as it has names, found [7]"
    assert told in whats(exported_run / "lerobot")
    del info["features"][ACTION]
    path.write_text(json.dumps(info))
    assert f"expected feature '{ACTION}' of dtype float32, got none" in whats(path.parent.parent)


def test_a_data_file_that_was_cut_or_lost_is_found(exported_run: Path) -> None:
    data = exported_run / "lerobot" / DATA
    data.write_bytes(data.read_bytes()[:-9])
    assert "not readable" in whats(exported_run / "lerobot")
    data.unlink()
    assert "no such file, though meta/episodes names it" in whats(exported_run / "lerobot")


def test_any_other_change_is_found_by_the_fingerprint(exported_run: Path) -> None:
    root = exported_run / "lerobot"
    (root / "meta" / "note.txt").write_text("hello")
    assert whats(root) == f"{root}: the files are not those that convert wrote"


def test_a_newer_schema_is_refused_by_name(exported_run: Path) -> None:
    path = exported_run / "lerobot" / DOCUMENT
    path.write_text(path.read_text().replace("codediffuser.dataset/2", "codediffuser.dataset/9"))
    with pytest.raises(SchemaVersionError, match=r"codediffuser\.dataset/9"):
        list(validate(exported_run / "lerobot"))
