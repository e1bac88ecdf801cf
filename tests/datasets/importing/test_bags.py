"""Bags of every kind become episodes: values, calibration, sync report, cuts, refusals."""

import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.episode_check import check_episode
from codediffuser.datasets.importing.big_bag import bag_config, make_bag
from codediffuser.datasets.importing.run import ImportReport
from codediffuser.datasets.importing.sources import open_source
from codediffuser.errors import ConfigError, DatasetError

KINDS = ("mcap", "sqlite3", "rosbag1", "mcap of ros1")


def write(bag, path, kind):
    if kind == "rosbag1":
        return bag.write_rosbag1(path.with_suffix(".bag"))
    if kind == "mcap of ros1":
        return bag.write_mcap_of_ros1(path.with_suffix(".mcap"))
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    return bag.write_rosbag2(path, plugin)


def only_episode(run):
    (folder,) = list_episodes(run)
    return Episode.open(folder, verify=True)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_gives_the_same_episode(kind, tmp_path, bag, make_config, run_import):
    run, results = run_import(write(bag, tmp_path / "bag", kind), make_config())
    assert [r.outcome for r in results] == ["imported"], results[0].reason
    episode = only_episode(run)
    assert check_episode(episode.folder) == []
    assert episode.num_frames == 40 and episode.hz == 20
    frames = list(episode.frames())
    times = np.load(episode.folder / "sync.npz")["frame_ns"]
    # Messages come 2 ms after their stamp, so each frame shows the latest picture before it.
    expected = [int((t - 1_700_000_000_002_000_000) * 30 // 10**9) for t in times.tolist()]
    assert [int(f.rgb["front"][0, 0, 0]) for f in frames] == expected
    assert [int(np.rint(f.depth_m["front"][0, 0] * 1000)) - 500 for f in frames] == expected
    assert frames[0].rgb["front"][0, 0].tolist()[1:] == [50, 200]
    assert np.allclose(episode.state[:, 9], 0.02)
    assert np.allclose(episode.state[:, 0] * 1000, episode.actions[:, 0] * 1000)
    camera = episode.cameras["front"]
    assert camera.K[0, 0] == 30 and np.allclose(camera.T_world_camera[:3, 3], [0, 0, 1.2])
    assert np.allclose(camera.T_world_camera[:3, 2], [0, 0, -1])


def test_a_clean_bag_reports_no_fault(tmp_path, bag, make_config, run_import):
    run, _ = run_import(bag.write_rosbag2(tmp_path / "bag"), make_config())
    recording = only_episode(run).manifest.recording
    assert recording.damage == ()
    for sync in recording.sync.signals.values():
        assert (sync.missing, sync.late, sync.reordered, sync.duplicates) == (0, 0, 0, 0)
        assert sync.faults == () and sync.held_frames == sync.dropped_frames == 0
        assert sync.skew_p50_ms <= sync.skew_p95_ms <= sync.skew_max_ms < 40


@pytest.mark.parametrize("clock", ["bag", "header"])
def test_the_sync_report_names_every_injected_fault(clock, tmp_path, bag, make_config, run_import):
    rng = np.random.default_rng(1)
    for k in range(60):
        jitter = int(rng.integers(-4e6, 4e6))
        bag.change("/cam/depth", k, stamp_ns=jitter, delay_ns=jitter)
    bag.drop("/cam/image", 10, 11, 30)
    bag.change("/ee_pose", 50, delay_ns=25_000_000)  # overtaken by two that follow
    bag.change("/joint_states", 80, delay_ns=18_000_000)
    for k in (20, 120):
        bag.change("/command", k, stamp_ns=-10_000_000)  # the stamp of the one before
    config = make_config(sync={"clock": clock, "max_age_s": 0.15})
    run, results = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    assert results[0].outcome == "imported", results[0].reason
    episode = only_episode(run)
    signals = episode.manifest.recording.sync.signals
    color, depth = signals["camera.front.color"], signals["camera.front.depth"]
    assert color.missing == 3
    assert [f.partition(" at ")[0] for f in color.faults] == ["2 missing", "1 missing"]
    assert depth.jitter_p95_ms > 2 and color.jitter_p95_ms < 0.1
    assert (signals["state.hand"].late, signals["state.hand"].reordered) == (1, 1)
    assert any(f.startswith("late by 25 ms at 0.5") for f in signals["state.hand"].faults)
    assert (signals["state.joints"].late, signals["state.joints"].reordered) == (1, 1)
    assert signals["action.hand"].duplicates == 2
    for name in ("camera.front.color", "camera.front.depth"):
        assert signals[name].late == signals[name].reordered == 0
    arrays = np.load(episode.folder / "sync.npz")
    for name in signals:
        assert (arrays[name] <= arrays["frame_ns"]).all(), name


def test_stale_signals_drop_frames_or_hold_and_both_are_counted(
    tmp_path, bag, make_config, run_import
):
    bag.drop("/cam/image", *range(20, 32))
    path = bag.write_rosbag2(tmp_path / "bag")
    limits = {"max_dropped_share": 0.5, "max_held_share": 0.5, "max_missing_share": 0.5,
              "max_skew_p95_s": 1.0}  # fmt: skip
    counts = {}
    for policy in ("drop", "hold"):
        config = make_config(sync={"on_stale": policy, "max_age_s": 0.1}, limits=limits)
        run, _ = run_import(path, config, run=tmp_path / policy)
        episode = only_episode(run)
        sync = episode.manifest.recording.sync
        counts[policy] = (episode.num_frames, sync.dropped_frames, sync.held_frames)
        assert sync.signals["camera.front.color"].missing == 12
    assert counts["hold"][0] == 40
    assert counts["hold"][1] == 0 and counts["hold"][2] == counts["drop"][1] > 0
    assert counts["drop"][0] + counts["drop"][1] == 40


def test_an_episode_beyond_a_limit_is_refused_with_the_reason(
    tmp_path, bag, make_config, run_import
):
    bag.drop("/cam/image", *range(20, 40))
    run, (result,) = run_import(bag.write_rosbag2(tmp_path / "bag"), make_config())
    assert result.outcome == "refused" and "camera.front.color" in result.reason
    assert "dropped" in result.reason and list_episodes(run) == []
    report = ImportReport.load(run / "import.json")
    assert report.episodes[0].reason == result.reason


def test_markers_cut_judge_and_discard(tmp_path, bag, make_config, run_import):
    for seconds, text in ((0.1, "start"), (0.5, "stop"), (0.6, "start"), (0.9, "failure"),
                          (1.0, "start"), (1.4, "discard"), (1.5, "start")):  # fmt: skip
        bag.mark(seconds, text)
    words = ("start", "stop", "failure", "discard")
    markers = [{"topic": "/episode", "value": w, "means": w} for w in words]
    config = make_config(episodes={"by": "markers", "markers": markers})
    run, results = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    results = sorted(results, key=lambda r: r.job.id)
    outcomes = [r.outcome for r in results]
    assert outcomes == ["imported", "imported", "refused", "refused"], [r.reason for r in results]
    assert "discarded" in results[2].reason
    assert "ends before it was stopped" in results[3].reason
    success = [Episode.open(f).manifest.success for f in list_episodes(run)]
    assert success == [True, False]


def test_gaps_and_times_cut(tmp_path, make_config, run_import, bag):
    for topic in ("/cam/image", "/cam/depth"):
        bag.drop(topic, *range(25, 40))
    path = bag.write_rosbag2(tmp_path / "bag")
    gaps = make_config(episodes={"by": "gaps", "gap_s": 0.4})
    _, results = run_import(path, gaps, run=tmp_path / "gaps")
    assert [r.outcome for r in results] == ["imported", "imported"], [r.reason for r in results]
    times = make_config(episodes={"by": "times", "times_s": [[0.1, 0.7], [1.4, 1.9], [9, 10]]})
    _, results = run_import(path, times, run=tmp_path / "times")
    results = sorted(results, key=lambda r: r.job.id)
    outcomes = [r.outcome for r in results]
    assert outcomes == ["imported", "imported", "refused"], [r.reason for r in results]


def test_a_reference_topic_gives_the_frames(tmp_path, bag, make_config, run_import):
    config = make_config(hz=30, sync={"reference": "/cam/image", "clock": "header"})
    run, _ = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    episode = only_episode(run)
    assert episode.num_frames == 60
    color = episode.manifest.recording.sync.signals["camera.front.color"]
    assert color.skew_max_ms == 0
    wrong = make_config(hz=25, sync={"reference": "/cam/image"})
    _, (result,) = run_import(tmp_path / "bag", wrong, run=tmp_path / "wrong")
    assert "runs at 30.00 Hz, hz says 25" in result.reason


def test_actions_from_the_next_state_are_the_state_one_frame_on(
    tmp_path, bag, make_config, run_import
):
    config = make_config(action={"from": "next_state"})
    run, _ = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    episode = only_episode(run)
    assert episode.num_frames == 39
    assert np.array_equal(episode.actions[:-1], episode.state[1:])
    assert "following frame" in episode.manifest.recording.sync.action


def test_hand_and_wrist_camera_come_from_moving_transforms(tmp_path, bag, make_config, run_import):
    bag.add_moving_transforms()
    front = {"color": "/cam/image", "depth": "/cam/depth", "info": "/cam/info"}
    K = [[30, 0, 15.5], [0, 30, 11.5], [0, 0, 1]]
    wrist = {"color": "/cam/image", "K": K, "frame": "wrist_optical", "moving": True}
    fingers = {"topic": "/joint_states", "joints": ["finger_left", "finger_right"]}
    config = make_config(
        cameras={"front": front, "wrist": wrist},
        state={"hand": {"frame": "tcp"}, "gripper": fingers},
        action={"from": "next_state"},
    )
    run, (result,) = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    assert result.outcome == "imported", result.reason
    episode = only_episode(run)
    assert check_episode(episode.folder) == []
    arrays = np.load(episode.folder / "sync.npz")
    number = (arrays["tf.tcp"] - 1_700_000_000_001_000_000) // 20_000_000
    assert np.allclose(episode.state[:, 0], number * 1e-3)
    poses = episode.camera_poses("wrist")
    assert np.allclose(poses[:, 0, 3], number * 1e-3) and np.allclose(poses[:, 1, 3], -0.1)
    assert set(episode.cameras) == {"front"}
    sync = episode.manifest.recording.sync.signals["tf.tcp"]
    assert sync.topic == "tf" and 0 < sync.skew_max_ms <= 20


def test_a_camera_that_moves_unannounced_is_refused(tmp_path, bag, make_config, run_import):
    bag.add_moving_transforms()
    wrist = {"color": "/cam/image", "info": "/cam/info", "frame": "wrist_optical"}
    config = make_config(cameras={"wrist": wrist})
    _, (result,) = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    assert "moves in 'world'; set moving: true" in result.reason


def test_joints_alone_are_a_state_of_their_own_kind(tmp_path, bag, make_config, run_import):
    joints = {"topic": "/joint_states"}
    config = make_config(state={"joints": joints}, action={"from": "command", "joints": joints})
    run, _ = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    episode = only_episode(run)
    assert episode.manifest.motion.kind == "joints"
    assert episode.manifest.motion.state_names[:2] == ("joint_0", "joint_1")
    assert episode.state.shape == (40, 4) and np.array_equal(episode.state, episode.actions)
    assert check_episode(episode.folder) == []


def test_interpolation_lies_between_and_is_told(tmp_path, bag, make_config, run_import):
    fingers = {"topic": "/joint_states", "joints": ["finger_left", "finger_right"]}
    hand = {"topic": "/ee_pose", "interpolate": True}
    state = {"joints": {"topic": "/joint_states"}, "hand": hand, "gripper": fingers}
    config = make_config(state=state, hz=30, sync={"clock": "header"})
    run, _ = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    episode = only_episode(run)
    assert episode.manifest.recording.sync.signals["state.hand"].method == "linear"
    frame_ns = np.load(episode.folder / "sync.npz")["frame_ns"] - 1_700_000_000_000_000_000
    # Its x is its number in millimetres at 100 Hz; beyond the last message nothing is mixed.
    inside = frame_ns < 1_980_000_000
    assert np.allclose(episode.state[inside, 0], frame_ns[inside] / 1e10, atol=1e-6)


@pytest.fixture
def small_bag(tmp_path):
    """An MCAP recording of two episodes in many chunks."""
    return make_bag(tmp_path / "small.mcap", 1, episodes=2, size=(32, 24), chunk_bytes=1 << 15)


@pytest.mark.parametrize("kind", ["mcap", "rosbag1"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_truncated_bag_gives_what_is_whole(kind, share, tmp_path, bag, small_bag):
    path = small_bag if kind == "mcap" else bag.write_rosbag1(tmp_path / "bag.bag")
    with closing(open_source(path)) as whole:
        assert whole.damage == []
        contents = {t: [whole.read(t, i) for i in range(len(n))] for t, n in whole.times_ns.items()}
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with closing(open_source(path)) as cut:
        assert any("cut off" in text for text in cut.damage)
        kept = sum(len(times) for times in cut.times_ns.values())
        assert abs(kept / sum(map(len, contents.values())) - share) < 0.15
        for topic, times in cut.times_ns.items():
            found = [cut.read(topic, i) for i in range(len(times))]
            assert found == contents[topic][: len(found)]


def test_a_damaged_chunk_costs_its_messages_alone(small_bag, run_import):
    data = bytearray(small_bag.read_bytes())
    middle = len(data) * 3 // 4
    data[middle : middle + 100] = bytes(100)
    small_bag.write_bytes(data)
    config = bag_config(5)
    loose = {"max_dropped_share": 0.5, "max_missing_share": 0.5}
    config = config.model_copy(update={"limits": config.limits.model_copy(update=loose)})
    run, results = run_import(small_bag, config)
    assert [r.outcome for r in results] == ["imported", "imported"], [r.reason for r in results]
    damage = [Episode.open(f).manifest.recording.damage for f in list_episodes(run)]
    assert damage[0] == () and "cannot be read" in damage[1][0]


def test_a_split_bag_without_metadata_is_read_in_order(tmp_path, bag):
    folder = bag.write_rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3)
    with closing(open_source(folder)) as whole:
        expected = {t: times.tolist() for t, times in whole.times_ns.items()}
    (folder / "metadata.yaml").unlink()
    first, second = folder / "bag_9.db3", folder / "bag_10.db3"
    shutil.copy(folder / "bag.db3", second)
    (folder / "bag.db3").rename(first)
    middle = 1_700_000_001_000_000_000
    for path, drop in ((first, ">="), (second, "<")):
        with sqlite3.connect(path) as database:
            database.execute(f"DELETE FROM messages WHERE timestamp {drop} {middle}")
    with closing(open_source(folder)) as split:
        assert {t: times.tolist() for t, times in split.times_ns.items()} == expected
        assert any("no metadata.yaml" in text for text in split.damage)
        last = len(split.times_ns["/cam/image"]) - 1
        assert split.read("/cam/image", last) and split.read("/cam/image", 0)


def test_a_second_import_keeps_what_is_there_and_a_stranger_is_refused(
    tmp_path, bag, make_config, run_import
):
    path = bag.write_rosbag2(tmp_path / "bag")
    run, _ = run_import(path, make_config())
    before = (run / "episodes/000000/episode.mcap").stat().st_mtime_ns
    _, (result,) = run_import(path, make_config())
    assert result.outcome == "kept"
    assert (run / "episodes/000000/episode.mcap").stat().st_mtime_ns == before
    with pytest.raises(ConfigError, match=r"first_id.*--overwrite"):
        run_import(path, make_config(hz=10))
    _, (result,) = run_import(path, make_config(hz=10), overwrite=True)
    assert result.outcome == "imported"


def test_scenes_are_attached_by_order(tmp_path, bag, make_config, run_import, small_scene):
    for number in (7, 8):
        scene = small_scene.model_copy(update={"scene_id": f"{number:06d}"})
        scene.save(tmp_path / "scenes" / f"{number:06d}.yaml")
    bag.write_rosbag2(tmp_path / "bags" / "a")
    bag.write_rosbag2(tmp_path / "bags" / "b")
    config = make_config(scenes={"folder": "scenes"}, instruction="")
    run, results = run_import(tmp_path / "bags", config, config_folder=tmp_path)
    assert [(r.job.id, r.job.address) for r in results] == [("000007", "a#0"), ("000008", "b#0")]
    episode = Episode.open(run / "episodes" / "000008")
    assert episode.scene.scene_id == "000008"
    assert episode.manifest.instruction == small_scene.instruction.text
    assert check_episode(episode.folder) == []


def test_a_missing_topic_is_refused_with_what_is_recorded(tmp_path, bag, make_config, run_import):
    config = make_config(cameras={"front": {"color": "/nope"}})
    _, (result,) = run_import(bag.write_rosbag2(tmp_path / "bag"), config)
    assert "'/nope', which is not recorded" in result.reason and "/cam/image" in result.reason


def test_nothing_to_import_is_an_error(tmp_path, make_config, run_import):
    with pytest.raises(DatasetError, match="nothing to import here"):
        run_import(tmp_path, make_config())
