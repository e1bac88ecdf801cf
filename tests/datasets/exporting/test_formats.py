"""Every format: read back by its owner's library, or by a reader of its published layout."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.export_meta import OTHER_DOCUMENT, DatasetDocument
from codediffuser.datasets.exporting.format import format_for
from codediffuser.errors import ConfigError, NotRegisteredError

FORMATS = ("zarr", "robomimic", "aloha", "maniskill", "rosbag2")


@pytest.fixture
def export(
    labelled_run: Callable[..., Path], small_config: CloudConfig
) -> Callable[..., tuple[Path, list[Episode]]]:
    """Export a run of two episodes; returns the folder and the episodes."""

    def run_export(to: str, profile: str | None = None) -> tuple[Path, list[Episode]]:
        run = labelled_run(2)
        kind, chosen = format_for(to, profile)
        for _ in convert_run(run, to=to, profile=profile, config=small_config):
            pass
        folders = sorted((run / "episodes").iterdir())
        return kind.default_out(run, chosen), [Episode.open(f) for f in folders]

    return run_export


def millimetres(episode: Episode, k: int, camera: str) -> np.ndarray:
    return np.rint(episode.frame(k).depth_m[camera] * 1000).astype(np.uint16)


def test_diffusion_policy_layout_of_zarr(export: Callable[..., Any]) -> None:
    """As `ReplayBuffer.create_from_path` of diffusion_policy reads it; it is not on PyPI."""
    import zarr

    root, episodes = export("zarr")
    buffer = zarr.open(str(root / "replay_buffer.zarr"), mode="r")
    ends = buffer["meta/episode_ends"][:]
    assert ends.dtype == np.int64 and ends.tolist() == [5, 11]
    assert all(len(array) == 11 for _, array in buffer["data"].arrays())
    for i, episode in enumerate(episodes):
        rows = slice(ends[i - 1] if i else 0, ends[i])
        assert np.array_equal(buffer["data/action"][rows], episode.actions)
        assert np.array_equal(buffer["data/state"][rows], episode.state)
    assert buffer["data/point_cloud"].shape == (11, 40, 5)


def test_zarr_holds_pictures(export: Callable[..., Any]) -> None:
    import zarr

    root, (first, second) = export("zarr", "portable")
    data = zarr.open(str(root / "replay_buffer.zarr"), mode="r")["data"]
    camera = second.manifest.cameras[0].name
    assert np.array_equal(data[f"img_{camera}"][5 + 3], second.frame(3).rgb[camera])
    assert np.array_equal(data[f"depth_{camera}"][2], millimetres(first, 2, camera))
    assert set(np.unique(data[f"mask_{camera}"][:])) > {0}


def test_robomimic_reads_it(export: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    root, episodes = export("robomimic")
    camera = episodes[0].manifest.cameras[0].name
    with h5py.File(root / "demo.hdf5") as file:
        assert file["data"].attrs["total"] == 11
        assert json.loads(file["data"].attrs["env_args"])["env_name"] == "pack_battery"
        for i, episode in enumerate(episodes):
            demo = file[f"data/demo_{i}"]
            assert demo.attrs["num_samples"] == episode.num_frames
            assert np.array_equal(demo["actions"], episode.actions)
            assert demo["dones"][:].tolist() == [0] * (episode.num_frames - 1) + [1]
            depth = demo[f"obs/{camera}_depth"][1, ..., 0]
            assert np.array_equal(depth, millimetres(episode, 1, camera))
        masks = {n: file[f"mask/{n}"][:].tolist() for n in ("train", "valid")}
        assert sorted(masks["train"] + masks["valid"]) == [b"demo_0", b"demo_1"]
    monkeypatch.syspath_prepend(str(Path(sys.prefix) / "robomimic"))  # put there by tools/setup.sh
    dataset_module = pytest.importorskip(
        "robomimic.utils.dataset", reason="tools/setup.sh could not fetch robomimic"
    )
    dataset = dataset_module.SequenceDataset(
        hdf5_path=str(root / "demo.hdf5"), obs_keys=["state", f"{camera}_image"],
        dataset_keys=["actions", "rewards", "dones"], seq_length=3, load_next_obs=False,
    )  # fmt: skip
    assert len(dataset) == 11
    item = dataset[6]
    assert np.array_equal(item["actions"], episodes[1].actions[1:4])
    assert np.array_equal(item["obs"]["state"], episodes[1].state[1:4])
    expected = episodes[1].frame(2).rgb[camera]
    assert np.array_equal(item["obs"][f"{camera}_image"][1], expected)


def test_act_reads_aloha_files(export: Callable[..., Any]) -> None:
    """As `EpisodicDataset.__getitem__` of tonyzhaozh/act reads them; it is not on PyPI."""
    root, episodes = export("aloha")
    for i, episode in enumerate(episodes):
        with h5py.File(root / f"episode_{i}.hdf5") as file:
            assert file.attrs["sim"] and not file.attrs["compress"]
            assert file["/action"].shape == (episode.num_frames, 10)
            qpos, qvel = file["/observations/qpos"][0], file["/observations/qvel"][0]
            assert np.allclose(qpos, episode.trajectory.qpos[0])
            assert np.allclose(qvel, episode.trajectory.qvel[0])
            for camera in (c.name for c in episode.manifest.cameras):
                picture = file[f"/observations/images/{camera}"][3]
                assert np.array_equal(picture, episode.frame(3).rgb[camera])
            assert np.array_equal(file["/action"][1:], episode.actions[1:])


def test_maniskill_loads_it(export: Callable[..., Any]) -> None:
    from mani_skill.trajectory.dataset import ManiSkillTrajectoryDataset

    root, episodes = export("maniskill")
    dataset = ManiSkillTrajectoryDataset(str(root / "trajectory.h5"), success_only=True)
    assert len(dataset) == 11 and dataset.env_id == "PackBattery-v1"
    assert np.array_equal(dataset.actions[5:], episodes[1].trajectory.actions)
    camera = episodes[1].manifest.cameras[0].name
    item = dataset[7]
    picture = item["obs"]["sensor_data"][camera]["rgb"]
    assert np.array_equal(picture, episodes[1].frame(2).rgb[camera])
    K = item["obs"]["sensor_param"][camera]["intrinsic_cv"]
    assert np.allclose(K[:2, 2] - 0.5, episodes[1].cameras[camera].K[:2, 2], atol=1e-4)


@pytest.mark.sim
def test_maniskill_environments_take_its_scenes_and_states(export: Callable[..., Any]) -> None:
    import gymnasium as gym
    import torch

    import codediffuser.datagen.envs  # noqa: F401  registers the environments

    root, episodes = export("maniskill")
    facts = json.loads((root / "trajectory.json").read_text())
    kwargs = {k: v for k, v in facts["env_info"]["env_kwargs"].items() if k != "sim_config"}
    env: Any = gym.make(facts["env_info"]["env_id"], **kwargs).unwrapped
    env.reset(**facts["episodes"][1]["reset_kwargs"])
    assert env.scene_spec == episodes[1].scene
    with h5py.File(root / "trajectory.h5") as file:
        states = file["traj_1/env_states"]
        wanted = {
            kind: {name: torch.from_numpy(rows[4:5]) for name, rows in states[kind].items()}
            for kind in states
        }
    env.set_state_dict(wanted)
    found = env.get_state_dict()
    for kind, entries in wanted.items():
        assert set(found[kind]) == set(entries)
        for name, state in entries.items():
            assert torch.allclose(found[kind][name], state, atol=1e-5), name
    env.close()


def test_rosbags_reads_the_recordings(export: Callable[..., Any]) -> None:
    from rosbags.highlevel import AnyReader

    root, episodes = export("rosbag2")
    for episode in episodes:
        with AnyReader([root / episode.id]) as reader:
            counts = {c.topic: c.msgcount for c in reader.connections}
            assert counts == episode.manifest.topics
            for connection, _, raw in reader.messages():
                reader.deserialize(raw, connection.msgtype)


def contents(root: Path) -> dict[str, Any]:
    """What an export holds, independent of how HDF5 lays it out."""
    found: dict[str, Any] = {}
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if path.suffix in (".h5", ".hdf5"):
            with h5py.File(path) as file:
                file.visititems(
                    lambda key, item, name=name: found.setdefault(
                        f"{name}:{key}",
                        item[()].tobytes() if isinstance(item, h5py.Dataset) else dict(item.attrs),
                    )
                )
        elif path.is_file() and name not in (OTHER_DOCUMENT, "README.md"):
            found[name] = path.read_bytes()
    return found


@pytest.mark.parametrize("to", [f for f in FORMATS if f != "rosbag2"])
def test_a_grown_run_encodes_only_what_is_new(
    to: str, export: Callable[..., Any], small_config: CloudConfig, tmp_path: Path
) -> None:
    root, episodes = export(to)
    run = tmp_path / "run"
    whole = contents(root)
    aside = tmp_path / "000001"
    shutil.move(episodes[0].folder, aside)
    again = list(convert_run(run, to=to, config=small_config))
    assert [(p.episode_id, p.reused) for p in again] == [("000002", True)]
    shutil.move(aside, episodes[0].folder)
    again = list(convert_run(run, to=to, config=small_config))
    assert [(p.episode_id, p.reused) for p in again] == [("000001", False), ("000002", True)]
    assert contents(root) == whole


@pytest.mark.parametrize("to", ["robomimic", "aloha", "maniskill"])
def test_files_do_not_depend_on_the_clock(
    to: str, labelled_run: Callable[..., Path], small_config: CloudConfig, tmp_path: Path
) -> None:
    run, found = labelled_run(1), []
    for out in (tmp_path / "early", tmp_path / "late"):
        for _ in convert_run(run, to=to, profile="portable", config=small_config, out=out):
            pass
        found.append([p.read_bytes() for p in sorted(out.glob("*.h*5"))])
        time.sleep(1.1)  # HDF5 notes whole seconds
    assert found[0] and found[0] == found[1]


@pytest.mark.parametrize("to", FORMATS)
def test_an_unchanged_run_is_not_touched(
    to: str, export: Callable[..., Any], small_config: CloudConfig, tmp_path: Path
) -> None:
    root, _ = export(to)
    before = {p: p.stat().st_mtime_ns for p in root.rglob("*")}
    assert all(p.reused for p in convert_run(tmp_path / "run", to=to, config=small_config))
    assert {p: p.stat().st_mtime_ns for p in root.rglob("*")} == before
    document = DatasetDocument.load(root / OTHER_DOCUMENT)
    assert document.format == to and len({e.part for e in document.episodes}) == 2


def test_unknown_formats_and_profiles_are_named(tmp_path: Path) -> None:
    with pytest.raises(NotRegisteredError, match="Did you mean 'zarr'"):
        list(convert_run(tmp_path, to="zar"))
    with pytest.raises(ConfigError, match=r"--to aloha: Unknown profile 'pointcloud'.*portable"):
        list(convert_run(tmp_path, to="aloha", profile="pointcloud"))
