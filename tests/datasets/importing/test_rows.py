"""ALOHA, robomimic, ManiSkill and zarr files, written by their owners' published layout."""

import json

import cv2
import h5py
import numpy as np
import pytest
import zarr
from scipy.spatial.transform import Rotation

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.episode_check import check_episode
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.first_config import guess_config
from codediffuser.datasets.importing.sources import find_sources, open_source
from codediffuser.datasets.importing.survey import survey_source
from codediffuser.errors import DatasetError

RNG = np.random.default_rng(0)
T, H, W = 6, 24, 32
RGB = RNG.integers(0, 256, (T, H, W, 3), np.uint8)
SMOOTH = np.broadcast_to(np.linspace(0, 255, W)[:, None], (T, H, W, 3)).astype(np.uint8)
DEPTH = RNG.integers(300, 2000, (T, H, W)).astype(np.uint16)


def write_aloha(path, *, compressed=False):
    images = np.ascontiguousarray(SMOOTH)
    with h5py.File(path, "w") as file:
        file.attrs["sim"] = False
        file.attrs["compress"] = compressed
        file["action"] = np.arange(T * 14, dtype=np.float32).reshape(T, 14)
        file["observations/qpos"] = np.arange(T * 14, dtype=np.float32).reshape(T, 14) + 100
        file["observations/qvel"] = np.zeros((T, 14), np.float32)
        for camera in ("cam_high", "cam_left_wrist"):
            if not compressed:
                file[f"observations/images/{camera}"] = images
                continue
            packed = [cv2.imencode(".jpg", i[..., ::-1])[1].reshape(-1) for i in images]
            longest = max(map(len, packed))
            rows = np.stack([np.pad(p, (0, longest - len(p))) for p in packed])
            file[f"observations/images/{camera}"] = rows
        if compressed:
            file["compress_len"] = np.zeros((2, T))


def write_robomimic(path, count=2):
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": 20}})
        for i in range(count):
            demo = data.create_group(f"demo_{i}")
            demo.attrs["num_samples"] = T
            demo["actions"] = np.zeros((T, 7))
            demo["rewards"] = np.arange(T) == (T - 1 if i == 0 else T)
            obs = demo.create_group("obs")
            obs["agentview_image"] = RGB
            obs["agentview_depth"] = (DEPTH / 1000).astype(np.float32)[..., None]
            obs["robot0_eef_pos"] = np.arange(T)[:, None] * np.array([0.01, 0, 0]) + 0.1 * i
            obs["robot0_eef_quat"] = Rotation.from_rotvec(
                np.arange(T)[:, None] * [0, 0, 0.1]
            ).as_quat()
            obs["robot0_gripper_qpos"] = np.tile([0.02, -0.02], (T, 1))
            obs["robot0_joint_pos"] = np.zeros((T, 7))


def write_maniskill(path):
    T_world_camera = np.eye(4)
    T_world_camera[:3, 3] = 0.1, 0.2, 0.9
    with h5py.File(path, "w") as file:
        group = file.create_group("traj_0")
        group["actions"] = np.zeros((T, 8), np.float32)
        group["success"] = np.arange(T) == T - 1
        more = np.concatenate([RGB, RGB[:1]])
        group["obs/agent/qpos"] = np.tile(np.append(np.zeros(7), [0.03, 0.03]), (T + 1, 1))
        group["obs/extra/tcp_pose"] = np.tile([0.1, 0, 0.2, 0, 1.0, 0, 0], (T + 1, 1))
        sensor = group.create_group("obs/sensor_data/base_camera")
        sensor["rgb"] = more
        sensor["depth"] = np.concatenate([DEPTH, DEPTH[:1]]).astype(np.int16)[..., None]
        parameters = group.create_group("obs/sensor_param/base_camera")
        K = np.array([[40.0, 0, W / 2], [0, 40.0, H / 2], [0, 0, 1]])
        parameters["intrinsic_cv"] = np.tile(K, (T + 1, 1, 1)).astype(np.float32)
        extrinsic = np.linalg.inv(T_world_camera)[:3]
        parameters["extrinsic_cv"] = np.tile(extrinsic, (T + 1, 1, 1)).astype(np.float32)
    path.with_suffix(".json").write_text(json.dumps({"episodes": [], "env_info": {}}))


def write_zarr(path):
    root = zarr.open_group(str(path), mode="w")
    rows = np.arange(2 * T * 2, dtype=np.float32).reshape(2 * T, 2)
    root.create_dataset("data/state", data=rows, chunks=(5, 2))
    root.create_dataset("data/action", data=rows + 0.5, chunks=(5, 2))
    root.create_dataset("data/img", data=np.concatenate([RGB, RGB[::-1]]), chunks=(5, H, W, 3))
    root.create_dataset("meta/episode_ends", data=np.array([T - 1, 2 * T]))


def imported(path, run_import, **changes):
    guess = guess_config(survey_source(find_sources(path)[0]), "pack_battery")
    guess |= {"instruction": "Put a battery away.", "image": {"format": "png"}} | changes
    run, results = run_import(path, ImportConfig.parse(guess, "guess"))
    assert {r.outcome for r in results} == {"imported"}, [r.reason for r in results]
    episodes = [Episode.open(folder, verify=True) for folder in list_episodes(run)]
    for episode in episodes:
        assert check_episode(episode.folder) == []
    return episodes


@pytest.mark.parametrize("compressed", [False, True])
def test_aloha_keeps_joints_and_pictures(compressed, tmp_path, run_import):
    write_aloha(tmp_path / "episode_0.hdf5", compressed=compressed)
    write_aloha(tmp_path / "episode_10.hdf5", compressed=compressed)
    image = {"format": "jpeg" if compressed else "png"}
    episode, second = imported(tmp_path, run_import, image=image)
    assert second.manifest.recording.path == "episode_10.hdf5"
    motion = episode.manifest.motion
    assert motion.kind == "joints" and motion.state_names[6] == "left_gripper"
    assert episode.hz == 50 and episode.state.shape == (T, 14)
    assert np.array_equal(episode.actions + 100, episode.state)
    frames = list(episode.frames())
    assert frames[0].depth_m == {} and episode.cameras == {}
    error = np.abs(frames[2].rgb["cam_high"].astype(int) - SMOOTH[2]).max()
    assert error <= (8 if compressed else 0)


def test_robomimic_poses_depth_and_success(tmp_path, run_import):
    write_robomimic(tmp_path / "demo.hdf5")
    first, second = imported(tmp_path / "demo.hdf5", run_import)
    assert (first.manifest.success, second.manifest.success) == (True, False)
    assert first.num_frames == T - 1 and np.array_equal(first.actions[:-1], first.state[1:])
    assert np.allclose(first.state[:, 0], np.arange(T - 1) * 0.01)
    R = Rotation.from_rotvec([0, 0, 0.1 * 3]).as_matrix()
    assert np.allclose(first.state[3, 3:9], [*R[:, 0], *R[:, 1]], atol=1e-6)
    assert np.allclose(first.state[:, 9], 0.02)
    frame = first.frame(2)
    assert np.array_equal(frame.rgb["agentview"], RGB[2])
    assert np.allclose(frame.depth_m["agentview"] * 1000, DEPTH[2])
    assert first.cameras == {} and "not calibrated" in first.manifest.recording.damage[0]


def test_maniskill_brings_its_calibration(tmp_path, run_import):
    write_maniskill(tmp_path / "trajectory.h5")
    (episode,) = imported(tmp_path / "trajectory.h5", run_import)
    camera = episode.depth_cameras["base_camera"]
    assert camera.K[0, 2] == (W - 1) / 2 and camera.K[1, 2] == (H - 1) / 2
    assert np.allclose(camera.T_world_camera[:3, 3], [0.1, 0.2, 0.9], atol=1e-6)
    assert episode.manifest.source == "simulation" and episode.manifest.success
    assert np.allclose(episode.state[0, :3], [0.1, 0, 0.2])
    assert np.allclose(episode.state[0, 3:9], [1, 0, 0, 0, -1, 0], atol=1e-6)
    assert np.array_equal(episode.frame(1).rgb["base_camera"], RGB[1])


@pytest.mark.parametrize("packed", [False, True])
def test_zarr_is_cut_at_episode_ends(packed, tmp_path, run_import):
    path = tmp_path / "buffer.zarr"
    write_zarr(path)
    if packed:
        with zarr.ZipStore(str(tmp_path / "buffer.zarr.zip"), mode="w") as store:
            zarr.copy_store(zarr.DirectoryStore(str(path)), store)
        path = tmp_path / "buffer.zarr.zip"
    first, second = imported(path, run_import)
    assert (first.num_frames, second.num_frames) == (T - 1, T + 1)
    assert np.array_equal(second.state[0], [2 * (T - 1), 2 * (T - 1) + 1])
    assert np.allclose(second.actions - second.state, 0.5)
    assert np.array_equal(second.frame(0).rgb["camera"], RGB[T - 1])


def test_columns_in_all_layouts_are_poses():
    from codediffuser.datasets.importing.motion import pose_from_columns

    R = Rotation.from_euler("xyz", [0.1, -0.7, 2.0])
    x, y, z, w = R.as_quat()
    rows = {
        "xyz_quat_xyzw": [x, y, z, w], "xyz_quat_wxyz": [w, x, y, z], "xyz_rotvec": R.as_rotvec(),
        "xyz_rot6d": [*R.as_matrix()[:, 0], *R.as_matrix()[:, 1]],
    }  # fmt: skip
    for layout, rotation in rows.items():
        pose = pose_from_columns(np.array([1.0, 2.0, 3.0, *rotation]), layout, "x")
        assert np.allclose(pose[:3, :3], R.as_matrix()) and pose[:3, 3].tolist() == [1, 2, 3]
    with pytest.raises(DatasetError, match="needs 7 numbers"):
        pose_from_columns(np.zeros(6), "xyz_quat_wxyz", "x")


def test_a_moving_camera_brings_its_pose_with_every_frame(tmp_path, run_import):
    write_maniskill(tmp_path / "trajectory.h5")
    with h5py.File(tmp_path / "trajectory.h5", "a") as file:
        extrinsic = file["traj_0/obs/sensor_param/base_camera/extrinsic_cv"]
        extrinsic[:, 0, 3] = -0.1 * np.arange(T + 1)
    (episode,) = imported(tmp_path / "trajectory.h5", run_import)
    assert episode.cameras == {} and episode.manifest.cameras[0].moving
    poses = episode.camera_poses("base_camera")
    assert np.allclose(poses[:, 0, 3], 0.1 * np.arange(episode.num_frames), atol=1e-6)
    assert episode.camera_info("base_camera")[1:] == (W, H)


def test_files_of_no_known_layout_are_told(tmp_path):
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["something"] = np.zeros(3)
    with pytest.raises(DatasetError, match=r"expected ALOHA.*found something"):
        open_source(tmp_path / "x.h5")
    (tmp_path / "y.h5").write_bytes((tmp_path / "x.h5").read_bytes()[:100])
    with pytest.raises(DatasetError, match="no HDF5 file, or is cut off"):
        open_source(tmp_path / "y.h5")


def test_a_missing_data_set_is_refused_with_what_there_is(tmp_path, run_import):
    write_zarr(tmp_path / "a.zarr")
    joints = {"topic": "agent_pos"}
    config = ImportConfig.parse(
        {"schema": "codediffuser.import/1", "task": "t", "hz": 10, "state": {"joints": joints},
         "action": {"from": "next_state"}}, "test",
    )  # fmt: skip
    _, results = run_import(tmp_path / "a.zarr", config)
    assert "no data set agent_pos" in results[0].reason and "img" in results[0].reason
