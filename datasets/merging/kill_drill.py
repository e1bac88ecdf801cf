"""Kills merge at random moments and looks whether the next call makes up for it.

python -m codediffuser.datasets.merging.kill_drill RUN/lerobot --kills 10

A dataset is cut into shards. The reference is one merge of them that nobody disturbs. Then merges
into another folder get SIGKILL at random moments; after each, a merge into the same folder must end
with the same bytes, leave nothing behind, and not have changed the shards, whose files it links.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.datasets.export_meta import content_hashes
from codediffuser.datasets.merging.bench import split_into_shards
from codediffuser.drills import kill_after, start_verb
from codediffuser.errors import DatasetError
from codediffuser.files import TEMPORARY_PREFIX
from codediffuser.seeding import Stage, rng_for


@dataclass(kw_only=True)
class Options:
    """Kill `merge` at random moments."""

    dataset: tyro.conf.Positional[Path]
    """A LeRobot dataset with `shards` times `episodes` episodes."""
    shards: int = 3
    """How many datasets are merged."""
    episodes: int = 1
    """Episodes of each."""
    kills: int = 10
    seed: int = 0
    """Of the moments."""


@dataclass(frozen=True, slots=True)
class Kill:
    """One disturbed merge, which the next one made up for."""

    after_s: float
    """Since the merge began to write."""
    finished: bool
    """Whether it was faster than the signal."""
    left: int
    """Files that it left behind."""


def drill(options: Options, scratch: Path) -> Iterator[Kill]:
    """Disturb merges, and compare what the calls after them make.

    Yields:
        One item per kill.

    Raises:
        DatasetError: A merge after a killed one failed, differs from the undisturbed one, or left
            something behind; or the shards are not what they were.
    """
    shards = split_into_shards(options.dataset, options.shards, options.episodes, scratch / "in")
    before = content_hashes(scratch / "in")
    whole, out = scratch / "whole" / "merged", scratch / "out" / "merged"
    for folder in (whole, out):
        folder.parent.mkdir()
    started = _wait_for_work(process := _merge(shards, whole), whole)
    process.wait()
    takes_s = time.monotonic() - started
    expected = content_hashes(whole)
    moments = rng_for(options.seed, Stage.EXPERT, 0).uniform(0.0, 1.0, options.kills) * takes_s
    for after_s in moments:
        _wait_for_work(process := _merge(shards, out), out)
        finished = not kill_after(process, float(after_s))
        left = sum(path.is_file() for path in out.parent.rglob("*"))
        shutil.rmtree(out, ignore_errors=True)
        if _merge(shards, out).wait() != 0:
            raise DatasetError(f"{out}: the merge after a killed one failed")
        _compare(expected, content_hashes(out), str(out))
        _compare(before, content_hashes(scratch / "in"), "the shards")
        if others := [path.name for path in out.parent.iterdir() if path != out]:
            raise DatasetError(f"{out.parent}: left behind: {', '.join(others)}")
        shutil.rmtree(out)
        yield Kill(float(after_s), finished, left)


def _merge(shards: list[Path], out: Path) -> subprocess.Popen[bytes]:
    return start_verb("merge", *map(str, shards), "--out", str(out))


def _wait_for_work(process: subprocess.Popen[bytes], out: Path) -> float:
    """Let a merge load its libraries; returns when it began to write, or ended."""
    while process.poll() is None and not any(out.parent.glob(f"{TEMPORARY_PREFIX}*")):
        time.sleep(0.005)
    return time.monotonic()


def _compare(expected: dict[str, str], found: dict[str, str], what: str) -> None:
    names = sorted(name for name, _ in expected.items() ^ found.items())
    if names:
        raise DatasetError(
            f"{what}: differ from the undisturbed: {', '.join(dict.fromkeys(names))}"
        )


def _main() -> None:
    options, killed = tyro.cli(Options), 0
    with tempfile.TemporaryDirectory() as folder:
        for kill in drill(options, Path(folder)):
            killed += not kill.finished
            end = "finished before" if kill.finished else "killed"
            sys.stdout.write(f"{end} after {kill.after_s:.2f} s, {kill.left} files were there\n")
            sys.stdout.flush()
    sys.stdout.write(f"{killed} merges killed; what the next call made is equal, byte for byte\n")


if __name__ == "__main__":
    _main()
