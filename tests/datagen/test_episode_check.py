"""A good episode has no findings; each kind of damage is one that names its file and a remedy."""

import json

import numpy as np
import pytest

from codediffuser.datagen.episode_check import check_episode
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.files import sha256_file


def rewrite_manifest(folder, **changes):
    path = folder / "episode.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def refresh_hashes(folder):
    names = [p.name for p in folder.iterdir() if p.name != "episode.json"]
    files = {
        n: {"bytes": (folder / n).stat().st_size, "sha256": sha256_file(folder / n)} for n in names
    }
    rewrite_manifest(folder, files=files)


def only_finding(folder):
    findings = check_episode(folder)
    assert len(findings) == 1, findings
    return findings[0]


@pytest.fixture
def folder(tmp_path, write_synthetic_episode):
    return write_synthetic_episode(tmp_path)[0]


def test_a_good_episode_has_no_findings(folder):
    assert check_episode(folder) == []


def test_labels_beside_it_are_no_finding(folder):
    (folder / "labels.json").write_text("{}")
    assert check_episode(folder) == []


def test_a_missing_folder_is_one_finding(tmp_path):
    finding = only_finding(tmp_path / "000001")
    assert "episode.json is missing" in finding.what


def test_a_truncated_log_is_told_with_both_sizes(folder):
    log = folder / "episode.mcap"
    size = log.stat().st_size
    log.write_bytes(log.read_bytes()[:1000])
    finding = only_finding(folder)
    assert (finding.where, finding.what) == (str(log), f"expected {size} bytes, found 1000 bytes")
    assert finding.remedy == f"delete the folder {folder} and run demo again"


def test_changed_bytes_are_told(folder):
    states = folder / "states.npz"
    data = bytearray(states.read_bytes())
    data[len(data) // 2] ^= 1
    states.write_bytes(data)
    finding = only_finding(folder)
    assert finding.where == str(states)
    assert "SHA-256 differs" in finding.what


def test_a_log_that_is_cut_behind_the_manifests_back_is_told(folder):
    log = folder / "episode.mcap"
    log.write_bytes(log.read_bytes()[:-100])
    refresh_hashes(folder)
    findings = check_episode(folder)
    assert any(f.where == str(log) and "cannot be read" in f.what for f in findings)


def test_a_count_that_differs_is_told_by_topic(folder):
    topics = json.loads((folder / "episode.json").read_text())["topics"]
    rewrite_manifest(folder, topics=topics | {"/ee_pose": 5})
    assert only_finding(folder).what == "/ee_pose: expected 5 messages, found 4"


def test_another_clock_is_told(folder):
    rewrite_manifest(folder, hz=30)
    assert any("at every 1/30 s" in f.what for f in check_episode(folder))


def test_a_camera_that_sees_nothing_is_told(tmp_path, write_synthetic_episode, monkeypatch):
    from codediffuser.datagen import ros_messages as ros

    encode = ros.encode_depth
    monkeypatch.setattr(
        ros,
        "encode_depth",
        lambda d, t, frame: encode(np.zeros_like(d) if frame == "left_optical" else d, t, frame),
    )
    folder = write_synthetic_episode(tmp_path)[0]
    assert only_finding(folder).what == "camera 'left': no depth reading in any frame"


def test_states_of_another_episode_are_told(folder, make_trajectory):
    make_trajectory(4, seed=7).save(folder / "states.npz")
    refresh_hashes(folder)
    told = [f.what for f in check_episode(folder)]
    assert any(t.startswith("state of the log differ by up to") for t in told)
    assert any(t.startswith("actions of the log differ by up to") for t in told)


def test_states_of_another_length_are_told(folder, make_trajectory):
    make_trajectory(3).save(folder / "states.npz")
    refresh_hashes(folder)
    assert only_finding(folder).what == "expected 4 actions, found 3"


def test_states_of_other_objects_are_told(folder):
    states = Trajectory.load(folder / "states.npz")
    object.__setattr__(states, "object_ids", ("mug_0",))
    states.save(folder / "states.npz")
    refresh_hashes(folder)
    assert only_finding(folder).what == "expected states of ['battery_0'], found ['mug_0']"


def test_a_scene_of_another_instruction_is_told(folder):
    rewrite_manifest(folder, instruction="Put it back.")
    finding = only_finding(folder)
    assert finding.where == str(folder / "scene.yaml")
    assert finding.what.startswith("instruction: expected 'Put it back.'")


def test_a_renamed_folder_is_told(folder):
    moved = folder.rename(folder.with_name("000043"))
    finding = only_finding(moved)
    assert finding.remedy == "rename the folder to '000042'"


def test_a_success_that_is_none_is_told(folder):
    condition = {"name": "upright", "value": 0.1, "threshold": 0.99, "holds": False}
    rewrite_manifest(folder, conditions=[condition])
    assert only_finding(folder).what == ("says success, yet these conditions do not hold: upright")
