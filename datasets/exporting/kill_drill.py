"""Kills convert at random moments and looks whether the next call makes up for it.

python -m codediffuser.datasets.exporting.kill_drill RUN --kills 10 --num-episodes 3

The reference is one convert that nobody disturbs. Then a process converts the same run and gets
SIGKILL at a random moment, again and again; a last undisturbed call must end with the same bytes.
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

import numpy as np
import tyro

from codediffuser.datagen.episode import list_episodes
from codediffuser.datasets.export_meta import CARD, content_hashes
from codediffuser.datasets.exporting.format import format_for
from codediffuser.drills import kill_after, start_verb
from codediffuser.errors import DatasetError
from codediffuser.seeding import Stage, rng_for


@dataclass(kw_only=True)
class Options:
    """Kill `convert` at random moments."""

    run: tyro.conf.Positional[Path]
    """A run with labelled episodes; it is copied."""
    to: str = "lerobot"
    profile: str = "portable"
    num_episodes: int = 3
    kills: int = 10
    seed: int = 0
    """Of the moments."""


@dataclass(frozen=True, slots=True)
class Kill:
    """One disturbed call."""

    after_s: float
    """Since the call began its first part."""
    finished: bool
    """Whether it was faster than the signal."""
    parts: int
    """Episodes that were ready when it ended."""


def drill(options: Options, scratch: Path) -> Iterator[Kill]:
    """Disturb a convert, then compare.

    Yields:
        One item per kill.

    Raises:
        DatasetError: After all, the export is not that of the undisturbed call.
    """
    kind, profile = format_for(options.to, options.profile)
    for name in ("whole", "run"):
        # Both copies have one name, which is part of the export.
        for folder in list_episodes(options.run)[: options.num_episodes]:
            shutil.copytree(folder, scratch / name / "run" / "episodes" / folder.name)
    whole, run = scratch / "whole" / "run", scratch / "run" / "run"
    process = _convert(options, whole)
    _wait_for_work(process, whole)
    started = time.monotonic()
    process.wait()
    takes_s = time.monotonic() - started
    moments = rng_for(options.seed, Stage.EXPERT, 0).uniform(0.0, 1.0, options.kills) * takes_s
    for after_s in moments:
        process = _convert(options, run)
        _wait_for_work(process, run)
        finished = not kill_after(process, float(after_s))
        kept = run / ".cache" / "convert"
        yield Kill(float(after_s), finished, len(list(kept.glob("0*"))))
        if finished:
            shutil.rmtree(kind.default_out(run, profile), ignore_errors=True)
    if _convert(options, run).wait() != 0:
        raise DatasetError(f"{run}: the last, undisturbed convert failed")
    expected, found = (
        content_hashes(kind.default_out(folder, profile), without={CARD}) for folder in (whole, run)
    )
    differ = sorted(k for k in expected.keys() | found.keys() if expected.get(k) != found.get(k))
    if differ:
        raise DatasetError(f"{run}: differs from the undisturbed export in {', '.join(differ)}")
    left = [p.name for p in kind.default_out(run, profile).parent.glob(".partial-*")]
    if left or (run / ".cache" / "convert").exists():
        raise DatasetError(f"{run}: the last call left {left or 'its parts'} behind")


def _wait_for_work(process: subprocess.Popen[bytes], run: Path) -> None:
    """Let a call load its libraries: until it makes its first part, or has ended."""
    kept = run / ".cache" / "convert"
    before = set(kept.glob("*"))
    while process.poll() is None and set(kept.glob("*")) <= before:
        time.sleep(0.01)


def _convert(options: Options, run: Path) -> subprocess.Popen[bytes]:
    return start_verb("convert", str(run), "--to", options.to, "--profile", options.profile)


def _main() -> None:
    options = tyro.cli(Options)
    with tempfile.TemporaryDirectory() as folder:
        kills = []
        for kill in drill(options, Path(folder)):
            kills.append(kill)
            end = "finished before" if kill.finished else "killed"
            sys.stdout.write(f"{end} after {kill.after_s:.2f} s, {kill.parts} parts kept\n")
        hit = np.count_nonzero([not kill.finished for kill in kills])
    sys.stdout.write(f"{hit} kills; the export equals the undisturbed one, byte for byte\n")


if __name__ == "__main__":
    _main()
