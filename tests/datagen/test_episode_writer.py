"""An episode folder is whole or absent, the same bytes each time, and opens elsewhere."""

import dataclasses

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from codediffuser.datagen.episode_format import EpisodeManifest, ImageOptions
from codediffuser.datagen.log_step import Pictures, trajectory_steps
from codediffuser.errors import EpisodeError, ShapeError
from codediffuser.files import sha256_file

LOW_DIM = ("/joint_states", "/ee_pose", "/command/ee_pose", "/command/gripper")
PICTURES = (
    "/camera/left/color/compressed", "/camera/left/depth",
    "/camera/right/color/compressed", "/camera/right/depth",
)  # fmt: skip
ONCE = ("/tf_static", "/instruction", "/camera/left/camera_info", "/camera/right/camera_info")


def test_the_folder_holds_log_scene_states_and_a_manifest_of_them(
    tmp_path, write_synthetic_episode
):
    folder, _, _ = write_synthetic_episode(tmp_path)
    names = {"episode.mcap", "scene.yaml", "states.npz"}
    assert {p.name for p in folder.iterdir()} == names | {"episode.json"}
    manifest = EpisodeManifest.load(folder / "episode.json")
    assert set(manifest.files) == names
    for name, record in manifest.files.items():
        assert record.bytes == (folder / name).stat().st_size
        assert record.sha256 == sha256_file(folder / name)
    assert manifest.frames == 4
    assert manifest.topics == dict.fromkeys(ONCE, 1) | dict.fromkeys(LOW_DIM + PICTURES, 4)


def test_the_scene_is_copied_byte_for_byte(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    source = tmp_path / "scenes" / "000042.yaml"
    assert (folder / "scene.yaml").read_bytes() == source.read_bytes()


def test_writing_twice_gives_the_same_bytes(tmp_path, write_synthetic_episode):
    first, _, _ = write_synthetic_episode(tmp_path / "a")
    second, _, _ = write_synthetic_episode(tmp_path / "b")
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes(), path.name


def test_messages_stand_in_time_order_25_to_the_second(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    times = {}
    with (folder / "episode.mcap").open("rb") as stream:
        in_file_order = list(make_reader(stream).iter_messages(log_time_order=False))
    for _, channel, message in in_file_order:
        times.setdefault(channel.topic, []).append(message.log_time)
    all_times = [message.log_time for _, _, message in in_file_order]
    assert all_times == sorted(all_times)
    for topic in LOW_DIM + PICTURES:
        assert times[topic] == [0, 40_000_000, 80_000_000, 120_000_000]


def test_mcap_with_ros2_support_decodes_every_message(tmp_path, write_synthetic_episode):
    folder, trajectory, pictures = write_synthetic_episode(tmp_path)
    with (folder / "episode.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = [(c.topic, m) for _, c, _, m in reader.iter_decoded_messages()]
    assert len(decoded) == 4 + 4 * 8
    depth = [m for topic, m in decoded if topic == "/camera/right/depth"]
    pixels = np.frombuffer(depth[2].data, "<u2").reshape(depth[2].height, depth[2].width)
    np.testing.assert_array_equal(pixels, pictures[2].depth_mm["right"])
    joints = [m for topic, m in decoded if topic == "/joint_states"]
    np.testing.assert_array_equal(joints[3].position, trajectory.qpos[3])
    assert joints[0].name[0] == "panda_joint1" and joints[0].name[-1] == "panda_finger_joint2"


def test_rosbags_any_reader_opens_the_log(tmp_path, write_synthetic_episode):
    folder, trajectory, _ = write_synthetic_episode(tmp_path)
    with AnyReader([folder / "episode.mcap"]) as bag:
        assert set(bag.topics) == {*ONCE, *LOW_DIM, *PICTURES}
        opened = [
            bag.deserialize(raw, connection.msgtype).data
            for connection, _, raw in bag.messages()
            if connection.topic == "/command/gripper"
        ]
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability for c in bag.connections}
    np.testing.assert_array_equal(opened, trajectory.actions[:, 9].astype(float))
    assert durability["/tf_static"] is QosDurability.TRANSIENT_LOCAL
    assert durability["/ee_pose"] is QosDurability.VOLATILE


def test_nothing_stays_when_a_step_fails(tmp_path, write_synthetic_episode, monkeypatch):
    calls = []

    def fail_on_third(self, step):
        calls.append(step)
        if len(calls) == 3:
            raise RuntimeError("the simulator died")

    monkeypatch.setattr("codediffuser.datagen.log_writer.LogWriter.add_step", fail_on_third)
    with pytest.raises(RuntimeError, match="the simulator died"):
        write_synthetic_episode(tmp_path)
    assert list((tmp_path / "episodes").iterdir()) == []


def test_a_failed_rewrite_leaves_the_older_episode(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    before = sha256_file(folder / "episode.mcap")
    with pytest.raises(EpisodeError, match="at least one step"):
        write_synthetic_episode(tmp_path, num_steps=0)
    assert sha256_file(folder / "episode.mcap") == before
    assert [p.name for p in folder.parent.iterdir()] == ["000042"]


def test_a_log_that_does_not_read_back_is_not_kept(tmp_path, write_synthetic_episode, monkeypatch):
    def forget(self, step):
        self.num_steps += 1
        self.counts["/ee_pose"] = self.num_steps

    monkeypatch.setattr("codediffuser.datagen.log_writer.LogWriter.add_step", forget)
    with pytest.raises(EpisodeError, match="read back"):
        write_synthetic_episode(tmp_path)
    assert list((tmp_path / "episodes").iterdir()) == []


def test_kept_files_come_along(tmp_path, write_synthetic_episode):
    labels = tmp_path / "labels.json"
    labels.write_text("{}")
    folder, _, _ = write_synthetic_episode(tmp_path, keep=[labels])
    assert (folder / "labels.json").read_text() == "{}"
    assert "labels.json" not in EpisodeManifest.load(folder / "episode.json").files


def test_png_is_stored_as_png(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path, image=ImageOptions(format="png"))
    with AnyReader([folder / "episode.mcap"]) as bag:
        connections = [c for c in bag.connections if c.topic == PICTURES[0]]
        connection, _, raw = next(bag.messages(connections))
        message = bag.deserialize(raw, connection.msgtype)
    assert message.format == "png"
    assert bytes(message.data[:4]) == b"\x89PNG"


@pytest.mark.parametrize("given", [3, 5])
def test_pictures_must_be_as_many_as_actions(make_trajectory, given):
    with pytest.raises(EpisodeError, match="expected 4 sets of pictures, got"):
        list(trajectory_steps(make_trajectory(4), [None] * given))


def test_a_missing_camera_is_named(tmp_path, write_synthetic_episode, monkeypatch):
    def without_right(trajectory, pictures):
        for step in trajectory_steps(trajectory, pictures):
            seen = {"left": step.pictures.rgb["left"]}
            yield dataclasses.replace(step, pictures=Pictures(seen, {}))

    monkeypatch.setattr("codediffuser.datagen.log_step.trajectory_steps", without_right)
    with pytest.raises(ShapeError, match="step 0: no depth_mm picture of camera 'left'"):
        write_synthetic_episode(tmp_path)
