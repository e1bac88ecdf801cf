"""Measures the import of a large recording: speed and memory.

python -m codediffuser.datasets.importing.bench --gigabytes 20

A recording is made, and imported by a process of its own. Both lie in a temporary folder: set
`TMPDIR` to a disk that has the room.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from codediffuser.datasets.importing.big_bag import CAMERA_HZ, bag_config, make_bag
from codediffuser.measuring import print_measured


@dataclass(kw_only=True)
class Options:
    """Import a recording of a size."""

    gigabytes: float = 2.0
    """Size of the recording (1e9 bytes each)."""
    hz: int = 2
    """Frames per second of the episodes; those of the recording have 30."""
    workers: int = 1
    """Processes of the import."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One import."""

    bag_mb: float
    made_s: float
    run_mb: float
    episodes: int
    hz: int
    wall_s: float
    cpu_s: float
    """Of all processes of the import."""
    peak_mb: float
    """Largest resident memory of any of them."""

    def __str__(self) -> str:
        return (
            f"recording: {self.bag_mb / 1e3:.2f} GB, {CAMERA_HZ} Hz, made in {self.made_s:.0f} s\n"
            f"import at {self.hz} Hz: {self.episodes} episodes, {self.run_mb / 1e3:.2f} GB\n"
            f"by the clock  {self.wall_s:6.1f} s   {self.bag_mb / self.wall_s:5.0f} MB/s\n"
            f"of processor  {self.cpu_s:6.1f} s   {self.bag_mb / self.cpu_s:5.0f} MB/s\n"
            f"peak memory of the largest process: {self.peak_mb:.0f} MB"
        )


def measure(options: Options, scratch: Path) -> Measured:
    """Make a recording and import it."""
    start = time.monotonic()
    bag = make_bag(scratch / "big.mcap", int(options.gigabytes * 1e9))
    made_s = time.monotonic() - start
    config, run = scratch / "import.yaml", scratch / "run"
    bag_config(options.hz).save(config)
    command = [
        sys.executable, "-m", "codediffuser.cli", "import", str(bag), "--config", str(config),
        "--out", str(run), "--workers", str(options.workers),
    ]  # fmt: skip
    start = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    wall_s = time.monotonic() - start
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Measured(
        bag_mb=bag.stat().st_size / 1e6,
        made_s=made_s,
        run_mb=sum(p.stat().st_size for p in run.rglob("*") if p.is_file()) / 1e6,
        episodes=len(list((run / "episodes").iterdir())),
        hz=options.hz,
        wall_s=wall_s,
        cpu_s=used.ru_utime + used.ru_stime,
        peak_mb=used.ru_maxrss / 1e3,
    )


if __name__ == "__main__":
    print_measured(Options, measure)
