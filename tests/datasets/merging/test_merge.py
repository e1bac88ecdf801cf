"""Facts about merging: the parts joined are the whole, checked, and never half there."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.export_meta import load_dataset_document
from codediffuser.datasets.merging.merge import merge_datasets
from codediffuser.datasets.merging.sources import open_sources
from codediffuser.datasets.merging.verify import verify_merge
from codediffuser.datasets.parquet_reader import read_episode_rows
from codediffuser.datasets.validate import validate
from codediffuser.errors import DatasetError


@pytest.fixture
def halves(tmp_path, made_once, labelled_run, small_config):
    """A dataset of four episodes, and the same episodes as two datasets; returns their folders."""

    def make(folder):
        run = labelled_run(4)
        folder.mkdir()
        for name, ids in (("whole", (1, 2, 3, 4)), ("first", (1, 2)), ("second", (3, 4))):
            part = tmp_path / name
            for i in ids:
                shutil.copytree(run / "episodes" / f"{i:06d}", part / "episodes" / f"{i:06d}")
            for _ in convert_run(part, config=small_config):
                pass
            shutil.copytree(part / "lerobot", folder / name)

    made_once("merge_halves", tmp_path / "made", make)
    return [tmp_path / "made" / name for name in ("whole", "first", "second")]


def merged(roots, out, **options):
    for _ in merge_datasets(roots, out, **options):
        pass
    return out


def frames(root):
    """All rows of a dataset, whatever files and row groups they lie in."""
    files = sorted((root / "data").glob("*/*.parquet"))
    return pa.concat_tables([pq.read_table(path) for path in files]).combine_chunks()


def content(root):
    """Every file of a dataset and its bytes, without our document's account of versions."""
    return {p.relative_to(root): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def test_merged_parts_equal_the_whole(halves, tmp_path):
    whole, *parts = halves
    out = merged(parts, tmp_path / "out")
    assert frames(out) == frames(whole)
    told, found = (json.loads((r / "meta/info.json").read_text()) for r in (whole, out))
    assert found == told
    keys = ("episode_index", "dataset_from_index", "dataset_to_index", "tasks", "length")
    rows = [[{k: row[k] for k in keys} for row in read_episode_rows(r)] for r in (whole, out)]
    assert rows[0] == rows[1]


def test_statistics_of_merged_parts_are_those_of_the_whole(halves, tmp_path):
    whole, *parts = halves
    out = merged(parts, tmp_path / "out")
    told, found = (json.loads((r / "meta/stats.json").read_text()) for r in (whole, out))
    assert told.keys() == found.keys()
    for key, stats in told.items():
        for name, values in stats.items():
            np.testing.assert_allclose(found[key][name], values, rtol=1e-6, atol=1e-9)


def test_merged_dataset_is_valid_and_knows_its_episodes(halves, tmp_path):
    whole, *parts = halves
    out = merged(parts, tmp_path / "out")
    assert list(validate(out)) == []
    told, found = (load_dataset_document(r).episodes for r in (whole, out))
    assert [(e.episode_index, e.episode_id, e.episode_sha256) for e in told] == [
        (e.episode_index, e.episode_id, e.episode_sha256) for e in found
    ]


def test_order_of_the_parts_is_the_order_of_the_episodes(halves, tmp_path):
    _, first, second = halves
    out = merged([second, first], tmp_path / "out")
    ids = [e.episode_id for e in load_dataset_document(out).episodes]
    assert ids == ["000003", "000004", "000001", "000002"]
    assert list(validate(out)) == []


def test_worker_count_does_not_change_the_bytes(halves, tmp_path):
    shutil.copytree(halves[1], tmp_path / "again")  # four files, so that processes are started
    one = merged(halves[1:], tmp_path / "one")
    two = merged(halves[1:], tmp_path / "two", workers=2)
    assert content(one) == content(two)


def test_merged_datasets_merge_again(halves, tmp_path):
    whole, first, second = halves
    singles = []
    for i, root in enumerate((first, second)):
        singles.append(tmp_path / f"part{i}")
        shutil.copytree(root, singles[-1])
    once = merged(singles, tmp_path / "once")
    other = tmp_path / "other"
    shutil.copytree(once, other)
    with pytest.raises(DatasetError, match="over again"):
        merged([once, other], tmp_path / "twice")
    assert frames(once) == frames(whole)


@pytest.mark.parametrize("copy", [False, True])
def test_unchanged_files_are_links_unless_copies_are_asked_for(halves, tmp_path, copy):
    out = merged(halves[1:], tmp_path / "out", link=not copy)
    first = out / "data/chunk-000/file-000.parquet"
    assert (first.stat().st_nlink == 1) is copy
    assert first.read_bytes() == (halves[1] / "data/chunk-000/file-000.parquet").read_bytes()


def test_opens_in_lerobot_and_equals_its_own_aggregation(halves, tmp_path):
    from lerobot.datasets.aggregate import aggregate_datasets
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    out = merged(halves[1:], tmp_path / "out")
    aggregate_datasets(["a/1", "a/2"], "a/all", roots=halves[1:], aggr_root=tmp_path / "theirs")
    mine, theirs = (LeRobotDataset("a/x", root=r) for r in (out, tmp_path / "theirs"))
    assert len(mine) == len(theirs)
    for k in (0, len(mine) // 2, len(mine) - 1):
        a, b = mine[k], theirs[k]
        assert a.keys() == b.keys()
        for key, value in a.items():
            same = value == b[key] if isinstance(value, str) else np.array_equal(value, b[key])
            assert same, key


def test_video_episodes_stay_with_their_pictures(tmp_path, make_video_dataset):
    parts = [make_video_dataset(tmp_path / f"v{i}", shade=i) for i in (1, 2)]
    out = merged(parts, tmp_path / "out", workers=1)
    rows = read_episode_rows(out)
    assert [row["videos/observation.images.cam/file_index"] for row in rows] == [0, 0, 1, 1]
    os.replace(
        out / "videos/observation.images.cam/chunk-000/file-000.mp4",
        out / "videos/observation.images.cam/chunk-000/file-001.mp4",
    )
    shutil.copy(
        parts[1] / "videos/observation.images.cam/chunk-000/file-000.mp4",
        out / "videos/observation.images.cam/chunk-000/file-000.mp4",
    )
    with pytest.raises(DatasetError, match="differs"):
        list(verify_merge(out, open_sources(parts)))


def test_verification_finds_a_changed_number(halves, tmp_path):
    out = merged(halves[1:], tmp_path / "out")
    path = out / "data/chunk-000/file-001.parquet"
    table = pq.read_table(path)
    at = table.schema.get_field_index("timestamp")
    values = table.column(at).to_numpy().copy()
    values[0] += 1
    changed = table.set_column(at, table.schema.field(at), pa.array(values))
    pq.write_table(changed, path)
    with pytest.raises(DatasetError, match=r"episode 2, which was episode 0 of .*frame 0 differs"):
        list(verify_merge(out, open_sources(halves[1:])))


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda info: info.update(fps=30), "fps is 30"),
        (lambda info: info.update(robot_type="ur5"), "robot_type is 'ur5'"),
        (lambda info: info["features"].pop("action"), "features differ.*: action;"),
        (
            lambda info: info["features"]["action"].update(dtype="float64"),
            r"features differ.*: action \(dtype is 'float64', there it is 'float32'\);",
        ),
    ],
)
def test_datasets_that_declare_different_things_are_refused(halves, tmp_path, change, message):
    path = halves[2] / "meta/info.json"
    info = json.loads(path.read_text())
    change(info)
    path.write_text(json.dumps(info))
    with pytest.raises(DatasetError, match=message):
        merged(halves[1:], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_bad_calls_are_refused_and_nothing_is_lost(halves, tmp_path):
    _, first, second = halves
    with pytest.raises(DatasetError, match="at least two datasets, got 1"):
        merged([first], tmp_path / "out")
    with pytest.raises(DatasetError, match="one of the datasets"):
        merged([first, second], second, overwrite=True)
    with pytest.raises(DatasetError, match="over again"):
        merged([first, first], tmp_path / "out")
    with pytest.raises(DatasetError, match="exists; choose another --out"):
        merged([first, second], halves[0])
    before = content(halves[0])
    (second / "data/chunk-000/file-000.parquet").unlink()
    with pytest.raises(DatasetError, match="no such file"):
        merged([first, second], halves[0], overwrite=True)
    assert content(halves[0]) == before


def test_killed_merge_leaves_nothing_and_the_next_is_the_same(halves, tmp_path):
    expected = content(merged(halves[1:], tmp_path / "expected"))
    out = tmp_path / "out"
    command = [sys.executable, "-m", "codediffuser.cli", "merge", *map(str, halves[1:])]
    for delay_s in (1.5, 2.2):
        process = subprocess.Popen(
            [*command, "--out", str(out), "--overwrite"], stderr=subprocess.DEVNULL
        )
        time.sleep(delay_s)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert not out.exists() or content(out) == expected
    assert content(merged(halves[1:], out, overwrite=True)) == expected
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
