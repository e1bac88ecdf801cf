"""Measures the import: size, speed and memory; and kills it.

`python -m codediffuser.datasets.importing.bench size --gigabytes 20` makes a recording, imports it
in a process of its own, and prints how large, how fast, and how much memory at most.
`python -m codediffuser.datasets.importing.bench kills --times 10` kills imports at random moments
with signal 9 and compares what re-running gives with an import that was left alone.
"""

from __future__ import annotations

import json
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import tyro

from codediffuser.datagen.episode_format import MANIFEST
from codediffuser.datasets.importing.big_bag import bag_config, make_bag
from codediffuser.drills import kill_after, start_verb
from codediffuser.errors import DatasetError
from codediffuser.files import sha256_file, sha256_json


def size(gigabytes: float = 2.0, hz: int = 2, folder: Path | None = None, workers: int = 1) -> None:
    """Import a recording of a size and print time and peak memory.

    Args:
        gigabytes: Size of the recording (1e9 bytes each).
        hz: Frames per second of the episodes; those of the recording have 30.
        folder: Where the recording and the run are made, and deleted; None: a temporary folder.
        workers: Processes of the import.
    """
    scratch = Path(tempfile.mkdtemp(prefix="import-bench-", dir=folder))
    try:
        start = time.monotonic()
        bag = make_bag(scratch / "big.mcap", int(gigabytes * 1e9))
        made_s, bag_mb = time.monotonic() - start, bag.stat().st_size / 1e6
        bag_config(hz).save(scratch / "import.yaml")
        _tell(f"recording: {bag_mb / 1e3:.2f} GB, 30 Hz, made in {made_s:.0f} s")
        start = time.monotonic()
        _import(scratch, scratch / "run", workers)
        taken_s = time.monotonic() - start
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        run_mb = sum(p.stat().st_size for p in (scratch / "run").rglob("*") if p.is_file()) / 1e6
        count = len(list((scratch / "run" / "episodes").iterdir()))
        _tell(f"import at {hz} Hz: {count} episodes, {run_mb / 1e3:.2f} GB")
        worked_s = used.ru_utime + used.ru_stime
        _tell(f"time: {taken_s:.0f} s wall, {worked_s:.0f} s processor")
        _tell(f"speed: {bag_mb / taken_s:.0f} MB/s of the recording by the clock")
        _tell(f"       {bag_mb / worked_s:.0f} MB/s of processor time")
        _tell(f"peak memory of the largest process: {used.ru_maxrss / 1e3:.0f} MB")
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def kills(
    times: int = 10, megabytes: float = 60.0, seed: int = 0, folder: Path | None = None
) -> None:
    """Kill imports at random moments, run them again, and compare with one left alone.

    Args:
        times: How many imports are killed.
        megabytes: Size of the recording.
        seed: Of the moments.
        folder: Where files are made, and deleted; None: a temporary folder.

    Raises:
        DatasetError: A result differs.
    """
    scratch = Path(tempfile.mkdtemp(prefix="import-kills-", dir=folder))
    try:
        make_bag(scratch / "big.mcap", int(megabytes * 1e6), episodes=6, size=(160, 120))
        bag_config(30).save(scratch / "import.yaml")
        start = time.monotonic()
        _import(scratch, scratch / "whole")
        whole_s = time.monotonic() - start
        expected, moments = contents(scratch / "whole"), random.Random(seed)
        for i in range(times):
            delay = moments.uniform(0.0, whole_s)
            killed = kill_after(start_verb(*_words(scratch, scratch / "cut")), delay)
            left = sum(1 for _ in (scratch / "cut").rglob("*"))
            _import(scratch, scratch / "cut")
            found = contents(scratch / "cut")
            if found != expected:
                names = sorted(n for n, _ in set(found.items()) ^ set(expected.items()))
                raise DatasetError(f"killed after {delay:.2f} s, others: {', '.join(names)}")
            what = "killed" if killed else "had ended"
            _tell(f"{i + 1}: {what} after {delay:.2f} s, {left} files were there; result equal")
            shutil.rmtree(scratch / "cut")
        _tell(f"{times} imports killed, all equal to the one that was left alone")
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def contents(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a run by its path.

    Of manifests the commit of this code is left out: a developer may commit between two imports.
    """
    return {
        str(path.relative_to(folder)): sha256_json(_without_commit(path))
        if path.name == MANIFEST
        else sha256_file(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _without_commit(path: Path) -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads(path.read_text())
    manifest.pop("git_commit")
    return manifest


def _import(scratch: Path, run: Path, workers: int = 1) -> None:
    command = [sys.executable, "-m", "codediffuser.cli", *_words(scratch, run, workers)]
    subprocess.run(command, check=True)


def _words(scratch: Path, run: Path, workers: int = 1) -> list[str]:
    return [
        "import", str(scratch / "big.mcap"), "--config", str(scratch / "import.yaml"),
        "--out", str(run), "--workers", str(workers),
    ]  # fmt: skip


def _tell(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"size": size, "kills": kills})
