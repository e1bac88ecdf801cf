"""Shuffled training windows per second beside LeRobot's own reader, in turns in one run.

python -m codediffuser.datasets.read_bench [RUN/lerobot]

Without a dataset one of 8000-point clouds is made in a temporary folder. Each side reads in a
process of its own through a torch `DataLoader` without workers, and tells its peak memory.
"""

from __future__ import annotations

import hashlib
import multiprocessing as mp
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.exporting.columns import arrow_table
from codediffuser.datasets.features import (
    ACTION,
    EPISODE_ID,
    LABELS,
    POINT_CHANNELS,
    POINTS,
    STATE,
    Feature,
    policy_features,
)
from codediffuser.datasets.lerobot_writer import LeRobotWriter
from codediffuser.measuring import print_measured

N_OBS_STEPS, HORIZON, FPS = 2, 16, 25
KEYS = (POINTS, STATE, ACTION)


@dataclass(kw_only=True)
class Options:
    """Read shuffled windows of 2 clouds, 2 states and 16 actions, by this toolkit and LeRobot."""

    dataset: tyro.conf.Positional[Path | None] = None
    """LeRobot dataset of the `pointcloud` profile; made for the occasion when left out."""
    points: int = 8000
    """Points of each cloud of the made dataset; of 5 numbers each."""
    episodes: int = 4
    """Episodes of 100 frames of the made dataset."""
    batch_size: int = 16
    """Windows of a batch."""
    rounds: int = 3
    """How often each side has its turn."""
    seconds: float = 5.0
    """Length of a turn; the batch that is being read at its end is finished and counted."""


@dataclass(frozen=True, slots=True)
class Side:
    """What one reader did."""

    windows_per_s: float
    """Median over the rounds."""
    open_s: float
    """Until the first batch could be asked for: building the cache, or loading the tables."""
    peak_mb: float
    """Largest resident memory of the process, with the pages of mapped files that it touched."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Both readers over the same windows."""

    cloud_numbers: int
    ours: Side
    reopen_s: float
    """How long ours takes to open once the cache is there, as in every later training."""
    lerobot: Side

    @property
    def ratio(self) -> float:
        """How many times faster ours is."""
        return self.ours.windows_per_s / self.lerobot.windows_per_s

    def __str__(self) -> str:
        lines = [
            f"shuffled windows of {N_OBS_STEPS} clouds of {self.cloud_numbers // 5} x 5 numbers, "
            f"{N_OBS_STEPS} states, {HORIZON} actions; DataLoader, one process"
        ]
        for name, side, how in (
            ("codediffuser", self.ours, "its cache of windows built"),
            ("LeRobotDataset", self.lerobot, "its tables loaded"),
        ):
            lines.append(
                f"{name:15} {side.windows_per_s:9.1f} windows/s   peak {side.peak_mb:6.0f} MB   "
                f"opened in {side.open_s:.1f} s, {how}"
            )
        lines.append(f"opened again    {self.reopen_s:9.1f} s, from the cache")
        return "\n".join([*lines, f"ratio           {self.ratio:9.0f} x"])


def measure(options: Options, scratch: Path) -> Measured:
    """Let both sides read in turns.

    Raises:
        DatasetError: The dataset cannot be read.
        RuntimeError: The two readers do not return the same numbers.
    """
    dataset = options.dataset or make_dataset(scratch / "made", options.points, options.episodes)
    # The hub is never asked, and what `datasets` caches goes where it is deleted.
    os.environ |= {"HF_HUB_OFFLINE": "1", "HF_DATASETS_CACHE": str(scratch / "hf")}
    readers = [_Reader(opener, dataset, options.batch_size, scratch) for opener in (_ours, _stock)]
    try:
        opened = [reader.ask(None) for reader in readers]
        if opened[0]["digest"] != opened[1]["digest"]:
            raise RuntimeError(f"{dataset}: the two readers return different windows")
        rates: list[list[float]] = [[], []]
        for _ in range(options.rounds):
            for found, reader in zip(rates, readers, strict=True):
                found.append(reader.ask(options.seconds)["rate"])
        sides = [
            Side(float(np.median(found)), start["open_s"], reader.ask(0.0)["peak_mb"])
            for found, start, reader in zip(rates, opened, readers, strict=True)
        ]
    finally:
        for reader in readers:
            reader.close()
    again = _Reader(_ours, dataset, options.batch_size, scratch)
    try:
        reopen_s = again.ask(None)["open_s"]
    finally:
        again.close()
    return Measured(opened[0]["cloud_numbers"], sides[0], reopen_s, sides[1])


def make_dataset(root: Path, points: int, episodes: int, frames: int = 100) -> Path:
    """Write a dataset of random clouds with the project's writer; return its folder."""
    config = CloudConfig(pick_points=0, place_points=0, hand_points=0, rest_points=points)
    features = policy_features(points, config.model_dump(mode="json"))
    columns = {k: f for k, f in features.items() if isinstance(f, Feature)}
    writer = LeRobotWriter(root, features, fps=FPS, robot_type="panda")
    rng = np.random.default_rng(0)
    for i in range(episodes):
        data: dict[str, Any] = {
            POINTS: rng.random((frames, points * len(POINT_CHANNELS)), dtype=np.float32),
            STATE: rng.random((frames, 10), dtype=np.float32),
            ACTION: rng.random((frames, 10), dtype=np.float32),
            LABELS: ["{}"] * frames,
            EPISODE_ID: [f"{i:06d}"] * frames,
        }
        writer.add_episode(arrow_table(columns, data, frames), "Pick a battery into a slot.")
    writer.finish()
    return root


class _Reader:
    """A process that opens a dataset and reads when it is asked to."""

    def __init__(self, opener: Callable[..., Any], root: Path, batch: int, scratch: Path) -> None:
        # Spawned, not forked: memory that this process has touched would count for the reader.
        context = mp.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, opener, root, batch, scratch), daemon=True
        )
        self._process.start()
        theirs.close()

    def ask(self, seconds: float | None) -> dict[str, Any]:
        """Read for that long; None opens the dataset."""
        self._pipe.send(seconds)
        try:
            answer: dict[str, Any] | Exception = self._pipe.recv()
        except EOFError:
            raise RuntimeError("a reading process died; see its message above") from None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the process."""
        if self._process.is_alive():
            self._pipe.send(None)
        self._process.join()


def _serve(
    pipe: Connection, opener: Callable[..., Any], root: Path, batch_size: int, scratch: Path
) -> None:
    try:
        pipe.recv()
        start = time.perf_counter()
        loader, window = opener(root, batch_size, scratch)
        batches = _endless(loader)
        open_s = time.perf_counter() - start
        values = [np.ascontiguousarray(window[key], dtype=np.float32) for key in KEYS]
        digest = hashlib.sha256(b"".join(v.tobytes() for v in values)).hexdigest()
        numbers = values[0].size // N_OBS_STEPS
        pipe.send({"open_s": open_s, "digest": digest, "cloud_numbers": numbers})
        while (seconds := pipe.recv()) is not None:
            start, count = time.perf_counter(), 0
            while (spent := time.perf_counter() - start) < seconds:
                count += len(next(batches)[ACTION])
            pipe.send({"rate": count / max(spent, 1e-9), "peak_mb": _peak_mb()})
    except Exception as error:  # the asking process raises it
        pipe.send(error)


def _endless(loader: Any) -> Iterator[dict[str, Any]]:
    epoch = 0
    while True:
        if hasattr(loader.dataset, "set_epoch"):
            loader.dataset.set_epoch(epoch)
        yield from loader
        epoch += 1


def _ours(root: Path, batch_size: int, scratch: Path) -> tuple[Any, Any]:
    """Loader, and window 1 for comparison."""
    from codediffuser.datasets.cache import WindowCache
    from codediffuser.datasets.loader import window_loader

    cache = WindowCache.open(root, scratch / "windows")
    sampler = cache.windows(n_obs_steps=N_OBS_STEPS, horizon=HORIZON)
    window = {key: values[0] for key, values in sampler.batch(np.array([1])).items()}
    return window_loader(sampler, batch_size), window


def _stock(root: Path, batch_size: int, scratch: Path) -> tuple[Any, Any]:
    """Loader, and window 1 for comparison."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import DataLoader

    from codediffuser.datasets.export_meta import load_info

    fps = load_info(root)["fps"]
    seen = [(i + 1 - N_OBS_STEPS) / fps for i in range(N_OBS_STEPS)]
    acted = [(i + 1 - N_OBS_STEPS) / fps for i in range(HORIZON)]
    dataset = LeRobotDataset(
        "bench/read", root=root, delta_timestamps={POINTS: seen, STATE: seen, ACTION: acted}
    )
    return DataLoader(dataset, batch_size=batch_size, shuffle=True), dataset[1]


def _peak_mb() -> float:
    """Largest resident memory of this process so far.

    Not `getrusage`: its figure outlives exec, and would be that of the process that spawned us.
    """
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


if __name__ == "__main__":
    print_measured(Options, measure)
