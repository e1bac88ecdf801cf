"""Windows from the mapped cache: LeRobot's values, built once, rebuilt when damaged."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from codediffuser.datasets.cache import INDEX, WindowCache
from codediffuser.datasets.export_meta import DOCUMENT, INFO, dataset_fingerprint
from codediffuser.datasets.features import ACTION, POINTS, STATE
from codediffuser.datasets.windows import WindowSampler
from codediffuser.errors import DatasetError, SchemaVersionError

STARTS = np.array([0, 3, 10])


@pytest.fixture
def sampler() -> WindowSampler:
    """Two episodes of 3 and 7 frames; every number is its frame's index."""
    column = np.arange(10, dtype=np.float32)[:, None]
    return WindowSampler(column, column, column, STARTS, episodes=[0, 1])


def test_a_window_holds_observations_up_to_now_and_actions_from_there(
    sampler: WindowSampler,
) -> None:
    batch = sampler.batch(np.array([5]))
    assert batch[POINTS][0, :, 0].tolist() == [4, 5]
    assert batch[STATE][0, :, 0].tolist() == [4, 5]
    assert batch[ACTION][0, :, 0].tolist() == [4, 5, 6, 7, 8] + [9] * 11
    assert batch["action_is_pad"][0].tolist() == [False] * 6 + [True] * 10
    assert batch["index"].tolist() == [5]


def test_the_start_of_an_episode_repeats_its_first_frame(sampler: WindowSampler) -> None:
    batch = sampler.batch(np.array([0, 3]))
    assert batch[STATE][:, :, 0].tolist() == [[0, 0], [3, 3]]
    assert batch[ACTION][1, :2, 0].tolist() == [3, 3]
    assert batch["action_is_pad"][1, :2].tolist() == [True, False]


def test_no_window_reaches_into_another_episode(sampler: WindowSampler) -> None:
    batch = sampler.batch(np.arange(10))
    episode = np.repeat([0, 1], np.diff(STARTS))
    for key in (POINTS, STATE, ACTION):
        touched = episode[batch[key][..., 0].astype(int)]
        assert (touched == episode[:, None]).all(), key


def test_other_lengths_of_history_and_horizon() -> None:
    column = np.arange(10, dtype=np.float32)[:, None]
    one = WindowSampler(column, column, column, STARTS, episodes=[1], n_obs_steps=1, horizon=4)
    assert one.batch(np.array([4]))[ACTION][0, :, 0].tolist() == [4, 5, 6, 7]
    assert len(one) == 7
    short = WindowSampler(column, column, column, STARTS, episodes=[0, 1], drop_last=5)
    assert short.frames.tolist() == [0, 3, 4], "an episode keeps its first frame"


def test_samples_come_from_the_chosen_episodes_and_the_generator_alone(
    sampler: WindowSampler,
) -> None:
    column = np.arange(10, dtype=np.float32)[:, None]
    one = WindowSampler(column, column, column, STARTS, episodes=[1])
    frames = one.sample(np.random.default_rng(0), 500)["index"]
    assert set(frames.tolist()) == set(range(3, 10))
    again = one.sample(np.random.default_rng(0), 500)["index"]
    assert np.array_equal(frames, again)


@pytest.mark.parametrize("episodes", [[], [2], [-1]])
def test_windows_of_no_episode_are_refused(episodes: list[int]) -> None:
    column = np.zeros((10, 1), np.float32)
    with pytest.raises(DatasetError, match="episodes from 0 to 1"):
        WindowSampler(column, column, column, STARTS, episodes=episodes)


def test_arrays_are_those_of_the_export(exported_run: Path) -> None:
    root = exported_run / "lerobot"
    cache = WindowCache.open(root)
    data = pq.read_table(root / "data/chunk-000/file-000.parquet").to_pydict()
    assert cache.points.shape == (18, 40, 5) and cache.points.dtype == np.float32
    assert np.array_equal(cache.points.reshape(18, -1), np.array(data[POINTS], np.float32))
    assert np.array_equal(cache.state, np.array(data[STATE], np.float32))
    assert np.array_equal(cache.action, np.array(data[ACTION], np.float32))
    assert cache.episode_starts.tolist() == [0, 5, 11, 18]
    assert cache.episode_ids == ("000001", "000002", "000003")
    assert cache.tasks[0] == "Pick a battery into a slot." != cache.tasks[1]
    assert (cache.num_frames, cache.num_episodes, cache.fps) == (18, 3, 25)
    assert cache.document is not None and cache.cloud == cache.document.cloud
    assert isinstance(cache.points, np.memmap)


def test_windows_are_those_of_the_stock_loader(
    exported_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "hf"))
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    observed, acted = [-1 / 25, 0.0], [i / 25 for i in range(-1, 15)]
    stock = LeRobotDataset(
        "local/run",
        root=exported_run / "lerobot",
        delta_timestamps={POINTS: observed, STATE: observed, ACTION: acted},
    )
    ours = WindowCache.open(exported_run / "lerobot").windows().batch(np.arange(18))
    for frame in range(18):
        theirs = stock[frame]
        for key in (POINTS, STATE, ACTION, "action_is_pad"):
            assert np.array_equal(theirs[key].numpy(), ours[key][frame]), (frame, key)


def test_the_cache_lies_beside_the_export_and_is_built_once(exported_run: Path) -> None:
    root = exported_run / "lerobot"
    before = dataset_fingerprint(root)
    WindowCache.open(root)
    (folder,) = (exported_run / ".cache" / "windows").iterdir()
    assert folder.name == before[:16]
    stamp = (folder / "points.npy").stat().st_mtime_ns
    WindowCache.open(root)
    assert (folder / "points.npy").stat().st_mtime_ns == stamp
    assert dataset_fingerprint(root) == before, "building does not touch the export"


@pytest.mark.parametrize("damage", ["flip", "cut", "missing", "index", "gone"])
def test_a_damaged_cache_is_built_again(exported_run: Path, damage: str) -> None:
    root = exported_run / "lerobot"
    expected = np.array(WindowCache.open(root).points)
    (folder,) = (exported_run / ".cache" / "windows").iterdir()
    points = folder / "points.npy"
    raw = bytearray(points.read_bytes())
    if damage == "flip":
        raw[-1] ^= 255
        points.write_bytes(raw)
    elif damage == "cut":
        points.write_bytes(raw[:-100])
    elif damage == "missing":
        points.unlink()
    elif damage == "index":
        (folder / INDEX).write_text("{")
    else:
        shutil.rmtree(folder)
    assert np.array_equal(WindowCache.open(root).points, expected)


def test_a_changed_export_gets_a_cache_of_its_own(exported_run: Path, tmp_path: Path) -> None:
    root = exported_run / "lerobot"
    WindowCache.open(root, tmp_path / "caches")
    info = root / INFO
    info.write_text(info.read_text().replace('"panda"', '"other"'))
    WindowCache.open(root, tmp_path / "caches")
    assert len(list((tmp_path / "caches").iterdir())) == 2


def test_a_dataset_of_another_kind_is_refused(exported_run: Path) -> None:
    with pytest.raises(DatasetError, match="no LeRobot dataset here"):
        WindowCache.open(exported_run)
    info = exported_run / "lerobot" / INFO
    text = info.read_text()
    info.write_text(text.replace(POINTS, "observation.image"))
    with pytest.raises(DatasetError, match=f"'{POINTS}'"):
        WindowCache.open(exported_run / "lerobot")
    info.write_text(text)
    document = exported_run / "lerobot" / DOCUMENT
    document.write_text(document.read_text().replace("codediffuser.dataset/2", "x.dataset/2"))
    with pytest.raises(SchemaVersionError, match=r"expected schema 'codediffuser\.dataset/2'"):
        WindowCache.open(exported_run / "lerobot")


def test_a_truncated_data_file_is_an_error_and_leaves_no_cache(exported_run: Path) -> None:
    data = exported_run / "lerobot/data/chunk-000/file-000.parquet"
    data.write_bytes(data.read_bytes()[:-50])
    with pytest.raises(DatasetError, match=r"not readable.*codediffuser convert RUN` again"):
        WindowCache.open(exported_run / "lerobot")
    assert not list((exported_run / ".cache" / "windows").glob("*"))


def test_more_than_1000_windows_a_second() -> None:
    """At the size of real clouds: 2 x 512 points and 16 actions in each window."""
    frames = 2000
    points = np.zeros((frames, 512 * 5), np.float32)
    low = np.zeros((frames, 10), np.float32)
    windows = WindowSampler(points, low, low, np.array([0, frames]), episodes=[0])
    rng = np.random.default_rng(0)
    start = time.process_time()
    for _ in range(10):
        windows.sample(rng, 64)
    assert 640 / (time.process_time() - start) > 1000
