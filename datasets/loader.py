"""Training windows for a torch `DataLoader`: whole batches, gathered by slicing mapped arrays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from codediffuser.datasets.windows import WindowSampler
from codediffuser.errors import ConfigError
from codediffuser.seeding import Stage, rng_for

TorchBatch = dict[str, torch.Tensor]


class WindowBatches(IterableDataset[TorchBatch]):
    """One pass over all windows of a sampler in shuffled batches.

    The order belongs to (seed, epoch) alone. Worker w of n takes every n-th batch, so the batches
    of an epoch are the same ones in the same order whatever the number of workers.

    Args:
        sampler: Gives the windows.
        batch_size: B.
        seed: Root seed of the shuffling.
        drop_last: Leave out a last batch of fewer than B windows.

    Raises:
        ConfigError: `batch_size` is below 1, or no batch is left.
    """

    def __init__(
        self, sampler: WindowSampler, batch_size: int, *, seed: int = 0, drop_last: bool = False
    ) -> None:
        if batch_size < 1:
            raise ConfigError(f"batch_size: expected at least 1, got {batch_size}")
        self._sampler, self._batch_size, self._seed = sampler, batch_size, seed
        self._drop_last = drop_last
        self.epoch = 0
        """Part of the address of the order; see `set_epoch`."""
        if len(self) == 0:
            raise ConfigError(
                f"batch_size: {batch_size} leaves no full batch of {len(sampler)} windows"
            )

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of the next pass. Call it before a pass begins."""
        self.epoch = epoch

    def __len__(self) -> int:
        """Batches of one pass."""
        whole, left = divmod(len(self._sampler), self._batch_size)
        return whole + (left > 0 and not self._drop_last)

    def __iter__(self) -> Iterator[TorchBatch]:
        """Yield the batches of this worker, see `WindowSampler.batch`."""
        info = get_worker_info()
        first, step = (0, 1) if info is None else (info.id, info.num_workers)
        rng = rng_for(self._seed, Stage.TRAIN, self.epoch)
        order = rng.permutation(self._sampler.frames)
        for i in range(first, len(self), step):
            frames = order[i * self._batch_size : (i + 1) * self._batch_size]
            yield as_tensors(self._sampler.batch(frames))


def as_tensors(batch: dict[str, np.ndarray]) -> TorchBatch:
    """The same memory as tensors; nothing is copied."""
    return {key: torch.from_numpy(values) for key, values in batch.items()}


def window_loader(
    sampler: WindowSampler,
    batch_size: int,
    *,
    seed: int = 0,
    workers: int = 0,
    drop_last: bool = False,
) -> DataLoader[TorchBatch]:
    """Return a `DataLoader` of shuffled batches; `loader.dataset.set_epoch(n)` reshuffles it.

    Args:
        sampler: Gives the windows.
        batch_size: B.
        seed: Root seed of the shuffling.
        workers: Processes. Gathering is faster than most training steps, so 0 is a good choice.
        drop_last: Leave out a last batch of fewer than B windows.

    Raises:
        ConfigError: `batch_size` is below 1, or no batch is left.
    """
    batches = WindowBatches(sampler, batch_size, seed=seed, drop_last=drop_last)
    # The dataset makes whole batches: a loader that joined single windows would copy them again.
    return DataLoader(batches, batch_size=None, num_workers=workers)
