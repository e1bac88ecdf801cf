"""Merging speed beside LeRobot's own tool, in turns in one run.

python -m codediffuser.datasets.merging.bench RUN/lerobot --shards 20
"""

from __future__ import annotations

import functools
import shutil
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.datasets.merging.merge import merge_datasets
from codediffuser.measuring import Turn, print_measured, take_turn

LIBRARIES = ("av", "lerobot.datasets.aggregate", "pandas")
"""Loaded before a turn's clock starts."""


@dataclass(kw_only=True)
class Options:
    """Split a dataset into shards and join them again, by this toolkit and by LeRobot."""

    dataset: tyro.conf.Positional[Path]
    """A LeRobot dataset with at least two episodes for each shard."""
    shards: int = 20
    """How many datasets are merged."""
    episodes: int = 2
    """Episodes of each."""
    rounds: int = 3
    """How often each side has its turn."""


def measure(options: Options, scratch: Path) -> str:
    """Time all sides in turns; all files are in the page cache."""
    shards = split_into_shards(
        options.dataset, options.shards, options.episodes, scratch / "shards"
    )
    sides: dict[str, Callable[[list[Path], Path], None]] = {
        "merge, verified": functools.partial(_ours, verify=True),
        "aggregate_datasets": _lerobot,
        "merge, --no-verify": functools.partial(_ours, verify=False),
    }
    turns: dict[str, list[Turn]] = {side: [] for side in sides}
    for _ in range(options.rounds):
        for side, work in sides.items():
            out = scratch / "merged"
            shutil.rmtree(out, ignore_errors=True)
            turns[side].append(take_turn(work, (shards, out), LIBRARIES))
    lines = [f"{options.shards} shards of {options.episodes} episodes; LeRobot's verifies nothing"]
    for side, mine in turns.items():
        wall = statistics.median(turn.wall_s for turn in mine)
        times = statistics.median(
            b.wall_s / a.wall_s for a, b in zip(mine, turns["aggregate_datasets"], strict=True)
        )
        peak = max(turn.peak_mb for turn in mine)
        lines.append(f"{side:20} {wall:7.2f} s  {times:5.1f}x  peak {peak:5.0f} MB")
    return "\n".join(lines)


def split_into_shards(dataset: Path, shards: int, episodes: int, out: Path) -> list[Path]:
    """Cut the first episodes of a dataset into datasets of a few each; returns their folders."""
    from lerobot.datasets.dataset_tools import split_dataset
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    parts = {f"shard_{i:03d}": list(range(i * episodes, (i + 1) * episodes)) for i in range(shards)}
    split_dataset(LeRobotDataset("bench/whole", root=dataset), parts, output_dir=out)
    return sorted(out.iterdir())


def _ours(shards: list[Path], out: Path, *, verify: bool) -> None:
    for _ in merge_datasets(shards, out, verify=verify):
        pass


def _lerobot(shards: list[Path], out: Path) -> None:
    from lerobot.datasets.aggregate import aggregate_datasets

    aggregate_datasets(
        [f"bench/{shard.name}" for shard in shards], "bench/all", roots=shards, aggr_root=out
    )


if __name__ == "__main__":
    print_measured(Options, measure)
