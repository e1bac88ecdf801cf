"""Shuffled batches for training: every window once, the same order for any number of workers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from codediffuser.datasets.cache import WindowCache
from codediffuser.datasets.features import ACTION, POINTS, STATE
from codediffuser.datasets.loader import WindowBatches, as_tensors, window_loader
from codediffuser.datasets.read_bench import Options, make_dataset, measure
from codediffuser.datasets.windows import WindowSampler
from codediffuser.errors import ConfigError


@pytest.fixture
def sampler() -> WindowSampler:
    """Two episodes of 3 and 7 frames; every number is its frame's index."""
    column = np.arange(10, dtype=np.float32)[:, None]
    return WindowSampler(column, column, column, np.array([0, 3, 10]), episodes=[0, 1])


def indices(batches: object) -> list[list[int]]:
    return [batch["index"].tolist() for batch in batches]  # type: ignore[attr-defined]


def test_a_pass_holds_every_window_once(sampler: WindowSampler) -> None:
    found = indices(window_loader(sampler, 4))
    assert [len(batch) for batch in found] == [4, 4, 2]
    assert sorted(i for batch in found for i in batch) == list(range(10))
    assert [len(b) for b in indices(window_loader(sampler, 4, drop_last=True))] == [4, 4]


def test_the_order_belongs_to_seed_and_epoch(sampler: WindowSampler) -> None:
    batches = WindowBatches(sampler, 4, seed=3)
    first = indices(batches)
    assert indices(batches) == first
    batches.set_epoch(1)
    assert indices(batches) != first
    assert indices(WindowBatches(sampler, 4, seed=4)) != first


def test_workers_change_nothing(sampler: WindowSampler) -> None:
    alone, helped = (list(window_loader(sampler, 4, workers=n)) for n in (0, 2))
    assert indices(alone) == indices(helped)
    for a, b in zip(alone, helped, strict=True):
        assert all(torch.equal(a[key], b[key]) for key in a)


def test_batches_are_float_tensors_of_windows(sampler: WindowSampler) -> None:
    batch = next(iter(window_loader(sampler, 4)))
    assert {k: tuple(v.shape) for k, v in batch.items()} == {
        POINTS: (4, 2, 1), STATE: (4, 2, 1), ACTION: (4, 16, 1), "action_is_pad": (4, 16),
        "index": (4,),
    }  # fmt: skip
    assert batch[POINTS].dtype == torch.float32
    assert batch["action_is_pad"].dtype == torch.bool


def test_tensors_share_the_memory_of_arrays(sampler: WindowSampler) -> None:
    arrays = sampler.batch(np.array([5]))
    as_tensors(arrays)[STATE][0, 0, 0] = 99
    assert arrays[STATE][0, 0, 0] == 99


def test_a_batch_that_never_fills_is_refused(sampler: WindowSampler) -> None:
    with pytest.raises(ConfigError, match="11 leaves no full batch of 10 windows"):
        window_loader(sampler, 11, drop_last=True)
    with pytest.raises(ConfigError, match="expected at least 1, got 0"):
        window_loader(sampler, 0)


def test_the_made_dataset_is_one_that_training_opens(tmp_path: Path) -> None:
    cache = WindowCache.open(make_dataset(tmp_path / "made", points=6, episodes=2, frames=5))
    assert cache.points.shape == (10, 6, 5)
    assert cache.episode_starts.tolist() == [0, 5, 10]


@pytest.mark.slow
def test_both_readers_return_the_same_windows(tmp_path: Path) -> None:
    options = Options(points=50, episodes=1, rounds=1, seconds=0.1, batch_size=4)
    measured = measure(options, tmp_path)
    assert measured.cloud_numbers == 250
    assert measured.ours.windows_per_s > measured.lerobot.windows_per_s
    assert measured.ours.peak_mb > 50
