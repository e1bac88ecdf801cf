"""What was written reads back, in parts and lazily; damage is one clear error."""

import json
import pickle
import tracemalloc

import numpy as np
import pytest

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.episode_format import ImageOptions
from codediffuser.errors import EpisodeError, SchemaVersionError
from codediffuser.poses import matrix_to_rot6d


def test_actions_and_state_are_those_of_the_trajectory(tmp_path, write_synthetic_episode):
    folder, trajectory, _ = write_synthetic_episode(tmp_path)
    episode = Episode.open(folder, verify=True)
    assert episode.actions.dtype == np.float32
    np.testing.assert_allclose(episode.actions, trajectory.actions, atol=2e-7)
    hand = np.stack([trajectory.T_world_hand(k) for k in range(4)])
    expected = np.column_stack(
        [hand[:, :3, 3], matrix_to_rot6d(hand[:, :3, :3]), trajectory.qpos[:4, 7:].mean(axis=1)]
    )
    assert episode.state.dtype == np.float32
    np.testing.assert_allclose(episode.state, expected, atol=2e-7)


def test_frames_stream_in_order_with_all_pictures(tmp_path, write_synthetic_episode):
    folder, _, pictures = write_synthetic_episode(tmp_path, image=ImageOptions(format="png"))
    frames = list(Episode.open(folder).frames())
    assert [f.index for f in frames] == [0, 1, 2, 3]
    assert [f.time_s for f in frames] == [0.0, 0.04, 0.08, 0.12]
    for frame, seen in zip(frames, pictures, strict=True):
        for name in ("left", "right"):
            np.testing.assert_array_equal(frame.rgb[name], seen.rgb[name])
            assert frame.depth_m[name].dtype == np.float32
            np.testing.assert_allclose(frame.depth_m[name] * 1000, seen.depth_mm[name], atol=1e-3)
            np.testing.assert_array_equal(frame.depth_mm[name], seen.depth_mm[name])


@pytest.mark.parametrize("k", [0, 2, 3, -1])
def test_one_frame_is_the_same_as_in_the_stream(tmp_path, write_synthetic_episode, k):
    folder, _, _ = write_synthetic_episode(tmp_path)
    episode = Episode.open(folder)
    streamed = list(episode.frames())[k]
    frame = episode.frame(k)
    assert frame.index == streamed.index
    for name in frame.rgb:
        np.testing.assert_array_equal(frame.rgb[name], streamed.rgb[name])
        np.testing.assert_array_equal(frame.depth_m[name], streamed.depth_m[name])


def test_parts_of_frames_can_be_asked_for(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    episode = Episode.open(folder)
    frames = list(episode.frames(["right"], 1, 3, color=False))
    assert [f.index for f in frames] == [1, 2]
    assert all(set(f.depth_m) == {"right"} and f.rgb == {} for f in frames)
    assert [f.index for f in episode.frames(color=False, depth=False)] == [0, 1, 2, 3]
    assert list(episode.frames(start=3, stop=2)) == []
    assert [f.index for f in episode.frames(start=2, stop=99)] == [2, 3]


def test_cameras_are_calibrated(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    cameras = Episode.open(folder).cameras
    assert list(cameras) == ["left", "right"]
    left = cameras["left"]
    assert (left.width, left.height, left.K[0, 0], left.K[0, 2]) == (32, 24, 30.0, 15.5)
    np.testing.assert_allclose(left.T_world_camera[3], [0, 0, 0, 1])
    assert not np.allclose(left.T_world_camera, cameras["right"].T_world_camera)


def test_scene_and_states_are_loaded(tmp_path, write_synthetic_episode):
    folder, trajectory, _ = write_synthetic_episode(tmp_path)
    episode = Episode.open(folder)
    assert episode.scene.scene_id == episode.id == "000042"
    assert episode.trajectory.num_steps == episode.num_frames == 4
    np.testing.assert_array_equal(episode.trajectory.qpos, trajectory.qpos)


def test_an_episode_can_be_pickled(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    episode = pickle.loads(pickle.dumps(Episode.open(folder)))
    assert episode.frame(1).index == 1


def test_memory_does_not_grow_with_the_episode(tmp_path, write_synthetic_episode):
    peaks = []
    for name, num_steps in (("000001", 20), ("000002", 500)):
        folder, _, _ = write_synthetic_episode(tmp_path, name, num_steps)
        episode = Episode.open(folder)
        tracemalloc.start()
        for _ in episode.frames(depth=False):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Chunks are about a megabyte: the reader may hold a few, never the episode.
    assert peaks[1] < peaks[0] + 6e6


def test_a_truncated_log_names_file_sizes_and_remedy(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    log = folder / "episode.mcap"
    size = log.stat().st_size
    log.write_bytes(log.read_bytes()[: size // 2])
    with pytest.raises(EpisodeError) as caught:
        Episode.open(folder)
    message = str(caught.value)
    assert str(log) in message
    assert f"expected {size} bytes, found {size // 2} bytes" in message
    assert "run demo again" in message


@pytest.mark.parametrize("read", ["cameras", "state", "frames", "frame"])
def test_a_log_that_shrinks_after_opening_is_one_error(tmp_path, write_synthetic_episode, read):
    folder, _, _ = write_synthetic_episode(tmp_path)
    episode = Episode.open(folder)
    log = folder / "episode.mcap"
    size = log.stat().st_size
    log.write_bytes(log.read_bytes()[: size // 2])
    with pytest.raises(EpisodeError, match=f"expected {size} bytes, found {size // 2}"):
        {
            "cameras": lambda: episode.cameras,
            "state": lambda: episode.state,
            "frames": lambda: list(episode.frames()),
            "frame": lambda: episode.frame(3),
        }[read]()


def with_zeros(log, share):
    data = bytearray(log.read_bytes())
    at = int(share * len(data))
    data[at : at + 64] = bytes(64)
    log.write_bytes(data)


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
def test_changed_bytes_are_found_by_their_hash(tmp_path, write_synthetic_episode, share):
    folder, _, _ = write_synthetic_episode(tmp_path)
    with_zeros(folder / "episode.mcap", share)
    with pytest.raises(EpisodeError, match="SHA-256 differs"):
        Episode.open(folder, verify=True)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_changed_pictures_are_found_by_reading_them(tmp_path, write_synthetic_episode, share):
    folder, _, _ = write_synthetic_episode(tmp_path, num_steps=30)
    with_zeros(folder / "episode.mcap", share)
    with pytest.raises(EpisodeError, match="run demo again"):
        list(Episode.open(folder).frames())


def test_a_missing_file_is_named(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    (folder / "states.npz").unlink()
    with pytest.raises(EpisodeError, match=r"states\.npz: expected \d+ bytes, found no file"):
        Episode.open(folder)


def test_a_folder_without_manifest_is_no_episode(tmp_path):
    with pytest.raises(EpisodeError, match=r"no episode here, episode\.json is missing"):
        Episode.open(tmp_path / "000042")


def test_a_damaged_manifest_is_an_episode_error(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    (folder / "episode.json").write_text('{"schema": "codediffuser.episode/1", "id": ')
    with pytest.raises(EpisodeError, match="not JSON"):
        Episode.open(folder)


def test_a_newer_manifest_is_refused_by_name(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    raw = json.loads((folder / "episode.json").read_text())
    raw["schema"] = "codediffuser.episode/9"
    (folder / "episode.json").write_text(json.dumps(raw))
    with pytest.raises(SchemaVersionError, match="newer than this codediffuser"):
        Episode.open(folder)


def test_unknown_frames_and_cameras_are_refused(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path)
    episode = Episode.open(folder)
    with pytest.raises(EpisodeError, match="no frame 4; it has 4 frames"):
        episode.frame(4)
    with pytest.raises(EpisodeError, match="no camera 'top'; it has left, right"):
        next(episode.frames(["top"]))


def test_listing_leaves_out_what_is_not_whole(tmp_path, write_synthetic_episode):
    assert list_episodes(tmp_path) == []
    for name in ("000007", "000003"):
        write_synthetic_episode(tmp_path, name)
    (tmp_path / "episodes" / ".partial-1-000009").mkdir()
    (tmp_path / "episodes" / "failures").mkdir()
    assert [p.name for p in list_episodes(tmp_path)] == ["000003", "000007"]
