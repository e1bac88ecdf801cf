"""Kills import, convert and merge at random moments; each next call must make up for it.

python -m codediffuser.datasets.kill_drill RUN --kills 10

For each verb the reference is one call that nobody disturbs. Then calls get SIGKILL at random
moments of their work; the call after each must end with the bytes of the reference, leave nothing
behind, and have changed nothing that it only reads. All is removed before the next kill.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import tyro

from codediffuser.datagen.episode import list_episodes
from codediffuser.datagen.episode_format import MANIFEST
from codediffuser.datasets.export_meta import CARD, content_hashes
from codediffuser.datasets.exporting.format import format_for
from codediffuser.datasets.importing.big_bag import CAMERA_HZ, bag_config, make_bag
from codediffuser.datasets.merging.bench import split_into_shards
from codediffuser.errors import DatasetError
from codediffuser.files import RETIRED_PREFIX, TEMPORARY_PREFIX, sha256_file, sha256_json
from codediffuser.seeding import Stage, rng_for

Verb = Literal["import", "convert", "merge"]


@dataclass(kw_only=True)
class Options:
    """Kill verbs at random moments, and compare what re-running makes."""

    run: tyro.conf.Positional[Path]
    """A run with labelled episodes; the first are copied."""
    verbs: tuple[Verb, ...] = ("import", "convert", "merge")
    kills: int = 10
    """Of each verb."""
    num_episodes: int = 2
    """How many are converted, and merged."""
    megabytes: float = 20.0
    """Size of the recording that is imported."""
    to: str = "lerobot"
    profile: str = "portable"
    """What convert makes."""
    seed: int = 0
    """Of the moments."""


@dataclass(frozen=True, slots=True)
class Kill:
    """One disturbed call that the next one made up for."""

    verb: str
    after_s: float
    """Since the call began to write."""
    finished: bool
    """Whether it was faster than the signal."""
    left: int
    """Files that it left behind."""

    def __str__(self) -> str:
        end = "finished before" if self.finished else "killed"
        return f"{self.verb:8} {end} after {self.after_s:5.2f} s, {self.left:3} files were there"


def drill(options: Options, scratch: Path) -> Iterator[Kill]:
    """Disturb every verb in turn.

    Args:
        options: Which verbs, and how often.
        scratch: An empty folder.

    Raises:
        DatasetError: A call after a killed one failed, left something behind, or made something
            else than the reference.
    """
    drills: dict[str, Callable[[Options, Path], VerbDrill]] = {
        "import": ImportDrill, "convert": ConvertDrill, "merge": MergeDrill,
    }  # fmt: skip
    for verb in options.verbs:
        (scratch / verb).mkdir()
        yield from drills[verb](options, scratch / verb).kill_and_repeat()


class VerbDrill(ABC):
    """A verb that writes to one place, again and again.

    Args:
        options: How often it is killed.
        scratch: An empty folder.
    """

    verb: ClassVar[str]

    def __init__(self, options: Options, scratch: Path) -> None:
        self.options = options
        self.scratch = scratch
        self.out = scratch / "out"
        """Holds all that a call writes."""
        self.words: list[str] = []
        """Arguments of the verb; `prepare` sets them."""
        self.prepare()

    @abstractmethod
    def prepare(self) -> None:
        """Make what the verb reads."""

    @abstractmethod
    def contents(self) -> dict[str, str]:
        """Hash of every file by its path, of the result and of what no call may change."""

    def clear(self) -> None:
        """Remove all that calls have written."""
        shutil.rmtree(self.out, ignore_errors=True)

    def kill_and_repeat(self) -> Iterator[Kill]:
        """Kill calls, and compare what the calls after them make.

        Raises:
            DatasetError: See `drill`.
        """
        started = self._wait_for_work(process := self._start())
        self._require(process.wait() == 0, "the call that nobody disturbs failed")
        takes_s = time.monotonic() - started
        expected = self.contents()
        self.clear()
        moments = rng_for(self.options.seed, Stage.EXPERT).uniform(0, takes_s, self.options.kills)
        for after_s in map(float, moments):
            self._wait_for_work(process := self._start())
            finished = not _kill_after(process, after_s)
            left = sum(path.is_file() for path in self.out.rglob("*"))
            when = f"after a kill at {after_s:.2f} s"
            self._require(self._start().wait() == 0, f"{when} the next call failed")
            names = sorted({name for name, _ in expected.items() ^ self.contents().items()})
            self._require(not names, f"{when} these differ: {', '.join(names)}")
            self._require(not self._leftovers(), f"{when} {self._leftovers()} stayed")
            self.clear()
            yield Kill(self.verb, after_s, finished, left)

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "codediffuser.cli", self.verb, *self.words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def _wait_for_work(self, process: subprocess.Popen[bytes]) -> float:
        """Let a call load its libraries; returns when it began to write, or ended."""
        while process.poll() is None and not self._leftovers():
            time.sleep(0.005)
        return time.monotonic()

    def _leftovers(self) -> list[str]:
        """What is written beside its place, to be renamed when it is whole."""
        prefixes = (TEMPORARY_PREFIX, RETIRED_PREFIX)
        # `os.walk`, for folders vanish under it while a call is at work.
        return [
            name
            for _, folders, files in os.walk(self.out)
            for name in (*folders, *files)
            if name.startswith(prefixes)
        ]

    def _require(self, good: bool, what: str) -> None:
        if not good:
            raise DatasetError(f"{self.verb}: {what}")


class ImportDrill(VerbDrill):
    """Import of a recording of six episodes."""

    verb = "import"

    def prepare(self) -> None:
        """Record."""
        bag, config = self.scratch / "big.mcap", self.scratch / "import.yaml"
        make_bag(bag, int(self.options.megabytes * 1e6), episodes=6, size=(160, 120))
        bag_config(CAMERA_HZ).save(config)
        self.words = [str(bag), "--config", str(config), "--out", str(self.out)]

    def contents(self) -> dict[str, str]:
        """Of the run."""
        return run_contents(self.out)


class ConvertDrill(VerbDrill):
    """Convert of a run, with the parts that it keeps while it works."""

    verb = "convert"

    def prepare(self) -> None:
        """Copy the run."""
        kind, profile = format_for(self.options.to, self.options.profile)
        self.made = kind.default_out(self.out, profile)
        self.words = [str(self.out), "--to", self.options.to, "--profile", profile]
        for folder in list_episodes(self.options.run)[: self.options.num_episodes]:
            shutil.copytree(folder, self.out / "episodes" / folder.name)

    def contents(self) -> dict[str, str]:
        """Of the whole run: parts must be gone, episodes as they were."""
        others = _hashes(self.out, but=self.made)
        return {**others, **content_hashes(self.made, without={CARD})}

    def clear(self) -> None:
        """Remove export and parts, and leave the episodes."""
        for path in self.out.iterdir():
            if path.name != "episodes":
                shutil.rmtree(path)


class MergeDrill(VerbDrill):
    """Merge of datasets, whose files it links."""

    verb = "merge"

    def prepare(self) -> None:
        """Convert the run and cut the dataset, an episode each."""
        convert = ConvertDrill(self.options, self.scratch / "converted")
        convert._require(convert._start().wait() == 0, "failed")
        shards = split_into_shards(
            convert.made, self.options.num_episodes, 1, self.scratch / "shards"
        )
        self.made = self.out / "merged"
        self.out.mkdir()
        # A killed call may have come so far that its result is there.
        self.words = [*map(str, shards), "--out", str(self.made), "--overwrite"]

    def contents(self) -> dict[str, str]:
        """Of the merged dataset and the shards."""
        return {**_hashes(self.scratch / "shards"), **content_hashes(self.made)}

    def clear(self) -> None:
        """Remove the merged dataset."""
        shutil.rmtree(self.out)
        self.out.mkdir()


def run_contents(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of an imported run by its path.

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


def _hashes(folder: Path, but: Path | None = None) -> dict[str, str]:
    """SHA-256 of every file below a folder by its path, without those below another."""
    return {
        str(path): sha256_file(path)
        for path in folder.rglob("*")
        if path.is_file() and (but is None or but not in path.parents)
    }


def _kill_after(process: subprocess.Popen[bytes], seconds: float) -> bool:
    """Give a process that many seconds to end, then end it by SIGKILL; whether that was needed."""
    try:
        process.wait(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False


def _main() -> None:
    options, killed = tyro.cli(Options), dict.fromkeys(("import", "convert", "merge"), 0)
    with tempfile.TemporaryDirectory(prefix="codediffuser-kills-") as folder:
        for kill in drill(options, Path(folder)):
            killed[kill.verb] += not kill.finished
            sys.stdout.write(f"{kill}\n")
            sys.stdout.flush()
    counts = ", ".join(f"{count} of {verb}" for verb, count in killed.items() if count)
    sys.stdout.write(f"{sum(killed.values())} kills ({counts}); every next call ended equal\n")


if __name__ == "__main__":
    _main()
