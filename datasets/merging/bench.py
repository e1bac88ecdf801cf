"""Merging speed beside LeRobot's own tool, in turns in one run.

python -m codediffuser.datasets.merging.bench RUN/lerobot --shards 20
"""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from codediffuser.datasets.merging.merge import merge_datasets
from codediffuser.measuring import print_measured


@dataclass(kw_only=True)
class Options:
    """Split a dataset into shards and join them again, by this toolkit and by LeRobot."""

    dataset: tyro.conf.Positional[Path]
    """A LeRobot dataset with at least two episodes for each shard."""
    shards: int = 20
    """How many datasets are merged."""
    episodes: int = 2
    """Episodes of each."""
    rounds: int = 2
    """How often each side has its turn."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Medians over the rounds."""

    shards: int
    episodes: int
    ours_s: float
    """With every episode verified."""
    unverified_s: float
    lerobot_s: float

    def __str__(self) -> str:
        return (
            f"{self.shards} shards of {self.episodes} episodes\n"
            f"merge, verified      {self.ours_s:8.2f} s   {self.lerobot_s / self.ours_s:6.1f}x\n"
            f"merge, --no-verify   {self.unverified_s:8.2f} s   "
            f"{self.lerobot_s / self.unverified_s:6.1f}x\n"
            f"aggregate_datasets   {self.lerobot_s:8.2f} s      1.0x   (verifies nothing)"
        )


def measure(options: Options, scratch: Path) -> Measured:
    """Time both sides in turns; all files are in the page cache."""
    shards = split_into_shards(
        options.dataset, options.shards, options.episodes, scratch / "shards"
    )
    times: dict[str, list[float]] = {"ours": [], "unverified": [], "lerobot": []}
    for _ in range(options.rounds):
        times["ours"].append(_ours(shards, scratch / "ours", verify=True))
        times["lerobot"].append(_lerobot(shards, scratch / "theirs"))
        times["unverified"].append(_ours(shards, scratch / "ours", verify=False))
    ours, unverified, lerobot = (float(np.median(t)) for t in (
        times["ours"], times["unverified"], times["lerobot"]
    ))  # fmt: skip
    return Measured(options.shards, options.episodes, ours, unverified, lerobot)


def split_into_shards(dataset: Path, shards: int, episodes: int, out: Path) -> list[Path]:
    """Cut the first episodes of a dataset into datasets of a few each; returns their folders."""
    from lerobot.datasets.dataset_tools import split_dataset
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    parts = {f"shard_{i:03d}": list(range(i * episodes, (i + 1) * episodes)) for i in range(shards)}
    split_dataset(LeRobotDataset("bench/whole", root=dataset), parts, output_dir=out)
    return sorted(out.iterdir())


def _ours(shards: list[Path], out: Path, *, verify: bool) -> float:
    start = time.perf_counter()
    for _ in merge_datasets(shards, out, verify=verify, overwrite=True):
        pass
    return time.perf_counter() - start


def _lerobot(shards: list[Path], out: Path) -> float:
    from lerobot.datasets.aggregate import aggregate_datasets

    shutil.rmtree(out, ignore_errors=True)
    start = time.perf_counter()
    aggregate_datasets(
        [f"bench/{shard.name}" for shard in shards], "bench/all", roots=shards, aggr_root=out
    )
    return time.perf_counter() - start


if __name__ == "__main__":
    print_measured(Options, measure)
