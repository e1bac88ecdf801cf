"""Export to LeRobot: opens in the stock loader, survives the stock tools, kills and damage."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import get_task
from codediffuser.datasets.clouds import CloudConfig, View, cloud_rng, policy_cloud
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.export_meta import (
    DOCUMENT,
    INFO,
    DatasetDocument,
    cloud_config,
    dataset_fingerprint,
    load_dataset_document,
)
from codediffuser.datasets.exporting.choice import choose_episodes
from codediffuser.datasets.features import ACTION, EPISODE_ID, LABELS, POINTS, STATE
from codediffuser.datasets.validate import validate
from codediffuser.errors import ConfigError, DatasetError, SchemaVersionError
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.label_document import Verdict
from codediffuser.labeling.marks import add_review
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.store import load_labels, save_labels


def convert(run: Path, *args: object, **options: object) -> Path:
    for _ in convert_run(run, *args, **options):  # type: ignore[arg-type]
        pass
    return run / "lerobot"


def review(run: Path, episode_id: str, verdict: Verdict) -> None:
    add_review(
        run / "episodes" / episode_id, verdict, "wrong slot", by="anna", at="", expected_revision=1
    )


def read(root: Path) -> dict[str, list[object]]:
    table: dict[str, list[object]] = pq.read_table(next(root.glob("data/*/*.parquet"))).to_pydict()
    return table


def files(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def test_columns_are_those_of_the_episodes(exported_run: Path) -> None:
    data = read(exported_run / "lerobot")
    row = 0
    for folder in sorted((exported_run / "episodes").iterdir()):
        episode = Episode.open(folder)
        stop = row + episode.num_frames
        assert np.array_equal(np.array(data[STATE][row:stop], np.float32), episode.state)
        assert np.array_equal(np.array(data[ACTION][row:stop], np.float32), episode.actions)
        assert set(data[EPISODE_ID][row:stop]) == {episode.id}
        assert data["frame_index"][row:stop] == list(range(episode.num_frames))
        assert np.allclose(data["timestamp"][row:stop], np.arange(episode.num_frames) / 25)
        row = stop
    assert row == len(data["index"]) == 5 + 6 + 7


def test_points_are_what_closed_loop_would_compute(
    exported_run: Path, small_config: CloudConfig
) -> None:
    folder = exported_run / "episodes" / "000002"
    episode, labels = Episode.open(folder), load_labels(folder).labels
    motion = RecordedMotion(episode, labels)
    field = AttentionField(labels, motion.at(0), radius_m=small_config.attention_radius_m)
    box = get_task("pack_battery").config.workspace
    k = 4
    frame = episode.frame(k)
    views = [View(frame.depth_m[n], c.K, c.T_world_camera) for n, c in episode.cameras.items()]
    seed = episode.manifest.seed
    assert seed is not None
    cloud = policy_cloud(
        views, field, motion.at(k), episode.trajectory.T_world_hand(k), np.array(box.low_m),
        np.array(box.high_m), cloud_rng(seed.root, seed.index, k), small_config,
    )  # fmt: skip
    exported = np.array(read(exported_run / "lerobot")[POINTS][5 + k], np.float32).reshape(-1, 5)
    # The hand pose goes through float32 in the log, which may reorder points at its edge.
    assert np.array_equal(exported[:28], cloud[:28])


def test_attention_follows_the_carried_battery(exported_run: Path) -> None:
    episode = Episode.open(exported_run / "episodes" / "000001")
    points = np.array(read(exported_run / "lerobot")[POINTS][:5], np.float32).reshape(5, -1, 5)
    for k in range(5):
        pick = points[k][points[k][:, 3] > 0][:, :3].mean(axis=0)
        battery = episode.trajectory.T_world_object("battery_0", k)[:3, 3]
        assert np.linalg.norm(pick[:2] - battery[:2]) < 0.008
        assert 0.0 < pick[2] - battery[2] < 0.065


def test_metadata_says_what_was_exported(exported_run: Path, small_config: CloudConfig) -> None:
    root = exported_run / "lerobot"
    info = json.loads((root / INFO).read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == 25
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 18, 2)
    assert info["features"][POINTS]["shape"] == [200]
    stats = json.loads((root / "meta/stats.json").read_text())
    assert len(stats[POINTS]["mean"]) == 5 and stats[POINTS]["count"] == [18]
    document = load_dataset_document(root)
    assert document.schema_name() == "codediffuser.dataset/2"
    assert document.cloud == cloud_config(root) == small_config
    assert [e.episode_id for e in document.episodes] == ["000001", "000002", "000003"]
    assert [e.frames for e in document.episodes] == [5, 6, 7]
    assert document.content_sha256 == dataset_fingerprint(root)


def test_labels_travel_as_json_without_history(exported_run: Path) -> None:
    first = json.loads(str(read(exported_run / "lerobot")[LABELS][0]))
    assert first["schema"].startswith("codediffuser.labels/")
    assert not {"history", "flags", "reviews", "saved"} & set(first)
    assert [label["instance_id"] for label in first["labels"]] == ["battery_0", "slot_0"]


def test_any_worker_count_gives_the_same_bytes(
    labelled_run: Callable[..., Path], small_config: CloudConfig, tmp_path: Path
) -> None:
    run = labelled_run(2)
    one = convert(run, config=small_config, workers=1)
    for _ in convert_run(run, tmp_path / "two", config=small_config, workers=2):
        pass
    assert files(one) == files(tmp_path / "two")


def test_failed_episodes_are_left_out_by_name(
    labelled_run: Callable[..., Path],
    write_battery_episode: Callable[..., Path],
    small_config: CloudConfig,
) -> None:
    run = labelled_run(1)
    write_battery_episode(run, "000009", success=False)
    document = load_dataset_document(convert(run, config=small_config))
    assert [e.episode_id for e in document.episodes] == ["000001"]
    assert document.left_out == ("000009",)


def test_rejected_labels_are_left_out_unless_asked_for(
    labelled_run: Callable[..., Path], small_config: CloudConfig
) -> None:
    run = labelled_run(3)
    review(run, "000002", "reject")
    assert choose_episodes(run).summary == ("2 episodes; left out: 1 with rejected labels: 000002")
    root = convert(run, config=small_config)
    document = load_dataset_document(root)
    assert [e.episode_id for e in document.episodes] == ["000001", "000003"]
    assert document.rejected == ("000002",) and document.left_out == ()
    assert "reviewer rejected their labels: 000002" in (root / "README.md").read_text()
    assert not list(validate(run))
    document = load_dataset_document(convert(run, config=small_config, with_rejected=True))
    assert len(document.episodes) == 3 and document.rejected == ()
    assert not list(validate(run))


def test_a_review_after_the_export_is_told(
    labelled_run: Callable[..., Path], small_config: CloudConfig
) -> None:
    run = labelled_run(2)
    convert(run, config=small_config)
    review(run, "000001", "accept")
    assert not list(validate(run))
    review(run, "000001", "reject")
    assert [f.kind for f in validate(run)] == ["export.outdated"]
    review(run, "000002", "reject")
    with pytest.raises(DatasetError, match=r"rejected the labels of all 2 .* --with-rejected"):
        convert(run, config=small_config)


def test_episodes_without_labels_are_listed_with_the_remedy(
    labelled_run: Callable[..., Path], write_battery_episode: Callable[..., Path]
) -> None:
    run = labelled_run(1)
    for episode_id in ("000007", "000008"):
        write_battery_episode(run, episode_id)
    with pytest.raises(
        DatasetError,
        match=r"2 of 3 .* no labels: 000007, 000008; run `codediffuser label .*run --auto`",
    ):
        convert(run)
    assert not (run / "lerobot").exists()


def test_a_run_without_successes_is_an_error(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    with pytest.raises(DatasetError, match="0 episodes, none of them successful"):
        convert(tmp_path)
    write_battery_episode(tmp_path, success=False)
    with pytest.raises(DatasetError, match="1 episodes, none of them successful"):
        convert(tmp_path)


def test_an_unknown_profile_is_an_error_with_a_hint(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="Did you mean 'pointcloud'"):
        convert(tmp_path, profile="pointclouds")


def test_what_convert_did_not_write_is_not_replaced(
    labelled_run: Callable[..., Path], small_config: CloudConfig
) -> None:
    run = labelled_run(1)
    (run / "lerobot").mkdir()
    (run / "lerobot" / "thesis.txt").write_text("dear")
    with pytest.raises(DatasetError, match=r"was not written by convert.*--overwrite"):
        convert(run, config=small_config)
    assert (run / "lerobot" / "thesis.txt").read_text() == "dear"
    convert(run, config=small_config, overwrite=True)
    assert (run / "lerobot" / DOCUMENT).exists()


def test_converting_again_after_new_labels_replaces_the_export(exported_run: Path) -> None:
    before = dataset_fingerprint(exported_run / "lerobot")
    folder = exported_run / "episodes" / "000001"
    pick, place = load_labels(folder).labels
    fields = {f: getattr(place, f) for f in place.__slots__}
    save_labels(folder, [pick, type(place)(**{**fields, "points_world": place.points_world[:30]})])
    config = load_dataset_document(exported_run / "lerobot").cloud
    root = convert(exported_run, config=config)
    assert dataset_fingerprint(root) != before
    assert load_dataset_document(root).episodes[0].labels_revision == 2


def test_a_broken_episode_stops_the_export_and_keeps_the_old_one(
    exported_run: Path, small_config: CloudConfig
) -> None:
    before = files(exported_run / "lerobot")
    log = exported_run / "episodes" / "000003" / "episode.mcap"
    log.write_bytes(log.read_bytes()[:-1000])
    with pytest.raises(DatasetError, match=r"episode 000003: .*expected \d+ bytes, found"):
        convert(exported_run, config=small_config)
    assert files(exported_run / "lerobot") == before


def test_a_second_convert_of_the_same_run_is_refused(
    labelled_run: Callable[..., Path], small_config: CloudConfig
) -> None:
    run = labelled_run(2)
    first = convert_run(run, config=small_config)
    next(first)
    with pytest.raises(DatasetError, match="another convert of this run is at work"):
        convert(run, config=small_config)
    for _ in first:
        pass
    assert not list(validate(run))


def test_a_killed_convert_continues_and_ends_with_the_same_bytes(
    labelled_run: Callable[..., Path], small_config: CloudConfig
) -> None:
    run = labelled_run(3)
    code = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from codediffuser.datasets.clouds import CloudConfig\n"
        "from codediffuser.datasets.convert import convert_run\n"
        "config = CloudConfig.model_validate_json(sys.argv[2])\n"
        "for item in convert_run(Path(sys.argv[1]), config=config):\n"
        "    print(item.episode_id, flush=True)\n"
        "    sys.stdin.readline()\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code, str(run), small_config.model_dump_json()],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert child.stdin is not None and child.stdout is not None
    assert child.stdout.readline() == "000001\n"
    child.stdin.write("\n")
    child.stdin.flush()
    assert child.stdout.readline() == "000002\n"
    os.kill(child.pid, signal.SIGKILL)
    child.communicate()
    assert not (run / "lerobot").exists()
    # One of what it kept is damaged as well: it is made again.
    next((run / ".cache" / "convert").glob("000001-*/columns.parquet")).write_bytes(b"half")
    progress = list(convert_run(run, config=small_config))
    assert [(p.episode_id, p.reused) for p in progress] == [
        ("000001", False), ("000002", True), ("000003", False),
    ]  # fmt: skip
    assert not list(validate(run))
    whole = files(run / "lerobot")
    assert files(convert(run, config=small_config)) == whole
    assert not (run / ".cache" / "convert").exists()


def test_a_partial_export_of_a_killed_process_is_removed(
    labelled_run: Callable[..., Path], small_config: CloudConfig
) -> None:
    run = labelled_run(1)
    left = run / ".partial-999999-lerobot"
    left.mkdir()
    assert any("left behind" in f.what for f in validate(run))
    convert(run, config=small_config)
    assert not left.exists()


def test_a_dataset_of_a_newer_schema_is_refused_by_name(exported_run: Path) -> None:
    path = exported_run / "lerobot" / DOCUMENT
    path.write_text(path.read_text().replace("codediffuser.dataset/2", "codediffuser.dataset/9"))
    with pytest.raises(SchemaVersionError, match=r"codediffuser\.dataset/9.*newer"):
        load_dataset_document(exported_run / "lerobot")


@pytest.mark.parametrize(
    ("info", "message"),
    [
        (None, "no LeRobot dataset here"),
        ("{", "not readable as JSON"),
        ("[]", "expected a mapping with 'features'"),
        ('{"codebase_version": "v2.1", "features": {}}', "expected codebase_version 'v3.0', got"),
    ],
)
def test_other_folders_are_refused(tmp_path: Path, info: str | None, message: str) -> None:
    if info is not None:
        (tmp_path / "meta").mkdir()
        (tmp_path / INFO).write_text(info)
    with pytest.raises(DatasetError, match=message):
        dataset_fingerprint(tmp_path)


def test_the_document_is_json_with_its_schema_first(exported_run: Path) -> None:
    text = (exported_run / "lerobot" / DOCUMENT).read_text()
    assert next(iter(json.loads(text))) == "schema"
    assert DatasetDocument.parse(json.loads(text), "x").profile == "pointcloud"


@pytest.fixture
def offline(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """LeRobot without network and with homes of its own."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "hf" / "datasets"))
    home = tmp_path / "lerobot_home"
    monkeypatch.setenv("HF_LEROBOT_HOME", str(home))
    return home


def test_the_stock_loader_opens_it(exported_run: Path, offline: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("local/run", root=exported_run / "lerobot")
    assert (len(dataset), dataset.num_episodes, dataset.fps) == (18, 3, 25)
    item = dataset[6]
    assert item["task"] == "Put the battery in the right slot."
    assert item[EPISODE_ID] == "000002" and item[POINTS].shape == (200,)
    assert dataset.meta.stats[POINTS]["std"].shape == (5,)


def stock_tool(*calls: list[str]) -> None:
    """Call `lerobot-edit-dataset` several times in one process, since loading it takes longest."""
    code = (
        "import json, sys\n"
        "from lerobot.scripts.lerobot_edit_dataset import main\n"
        "for arguments in json.loads(sys.argv[1]):\n"
        "    sys.argv = ['lerobot-edit-dataset', *arguments]\n"
        "    main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(calls)],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_stock_tools_split_merge_and_delete(exported_run: Path, offline: Path) -> None:
    from codediffuser.datasets.cache import WindowCache

    shutil.copytree(exported_run / "lerobot", offline / "me" / "all")

    def episodes(name: str) -> dict[str, np.ndarray]:
        root = offline / "me" / name
        assert not list(validate(root)), name
        cache = WindowCache.open(root, cache_folder=offline / "cache")
        assert cache.cloud == whole_config and cache.document is None
        cuts = zip(cache.episode_starts[:-1], cache.episode_starts[1:], strict=True)
        return {
            n: np.array(cache.points[a:b])
            for n, (a, b) in zip(cache.episode_ids, cuts, strict=True)
        }

    whole_config = cloud_config(offline / "me" / "all")
    stock_tool(
        ["--repo_id=me/all", f"--root={offline / 'me' / 'all'}", "--operation.type=split",
         '--operation.splits={"a": [0, 2], "b": [1]}'],
        ["--repo_id=me/joined", "--operation.type=merge",
         "--operation.repo_ids=['me/all_a', 'me/all_b']"],
        ["--repo_id=me/all", "--new_repo_id=me/fewer", "--operation.type=delete_episodes",
         "--operation.episode_indices=[0]"],
    )  # fmt: skip
    (offline / "me" / "all" / DOCUMENT).unlink()
    whole = episodes("all")
    for name, ids in (
        ("all_a", ["000001", "000003"]),
        ("all_b", ["000002"]),
        ("joined", ["000001", "000003", "000002"]),
        ("fewer", ["000002", "000003"]),
    ):
        found = episodes(name)
        assert list(found) == ids
        assert all(np.array_equal(found[n], whole[n]) for n in ids)


def test_converting_takes_little_time(exported_run: Path, small_config: CloudConfig) -> None:
    """18 frames of five small cameras; a slip to Python loops over points would take minutes."""
    start = time.process_time()
    convert(exported_run, config=small_config)
    assert time.process_time() - start < 5
