"""Runs every stock tool that should open our exports, and looks at what it made.

python -m codediffuser.datasets.exporting.stock_tools RUN

Some episodes of the run are exported, then each command is typed as its documentation says, in a
process of its own and without network. A result that is a dataset again must have the episodes that
were asked for, and `validate` must find nothing wrong with it. This prints a line as each command
ends; the exit code is 1 unless all work.
"""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.datagen.episode import list_episodes
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.exporting.format import Profile
from codediffuser.datasets.parquet_reader import read_episodes
from codediffuser.datasets.validate import validate

TIMEOUT_S = 1800.0
"""For one command; a longer one is taken for hung."""
ABORTED = "terminate called without an active exception"
"""What a program says when threads of Arrow are at work while Python ends: docs/exporting.md."""
POLICIES = ("act", "diffusion")


@dataclass(kw_only=True)
class Options:
    """Run stock tools on exports of a run."""

    run: tyro.conf.Positional[Path]
    """A run with labelled episodes."""
    num_episodes: int = 3
    """How many are exported; at least 3."""
    only: tuple[str, ...] = ()
    """Commands whose name has one of these words; all when left out."""
    steps: int = 5
    """Of each training."""


@dataclass(frozen=True, slots=True)
class Call:
    """One command, and what says whether it did what it should."""

    name: str
    command: Sequence[str]
    check: Callable[[str], str]
    """Gets the command's output; returns what is there now, or raises."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one command."""

    name: str
    profile: str
    seconds: float
    exit_code: int
    result: str
    works: bool

    def __str__(self) -> str:
        verdict = "works" if self.works else "FAILS"
        return (
            f"{verdict}  {self.profile:10}  {self.name:32} exit {self.exit_code:3}  "
            f"{self.seconds:6.1f} s   {self.result}"
        )


def run_tools(options: Options, scratch: Path) -> Iterator[Outcome]:
    """Export and run every command.

    Yields:
        What became of each command, in the order of `docs/exporting.md`.
    """
    chosen = list_episodes(options.run)[: options.num_episodes]
    run, home = scratch / "run", scratch / "lerobot"
    for folder in chosen:
        shutil.copytree(folder, run / "episodes" / folder.name)
    environment = {
        **os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(scratch / "hf"),
        "HF_LEROBOT_HOME": str(home),
    }  # fmt: skip
    profiles: tuple[Profile, ...] = ("portable", "masked-rgb", "pointcloud")
    for profile in profiles:
        name = profile.replace("-", "_")
        for _ in convert_run(run, home / "me" / name, profile=profile):
            pass
        calls = lerobot_calls(home, name, [folder.name for folder in chosen], options.steps)
        for call in _chosen(calls, options.only):
            yield _run(call, profile, environment, scratch)
    for _ in convert_run(run, scratch / "bags", to="rosbag2"):
        pass
    for call in _chosen(recording_calls(scratch / "bags", run), options.only):
        yield _run(call, "rosbag2", environment, scratch)


def lerobot_calls(home: Path, name: str, ids: Sequence[str], steps: int) -> Iterator[Call]:
    """Commands for the export at `home/me/name` of episodes with these ids."""
    root, repo = home / "me" / name, f"me/{name}"
    loaded = (
        "from lerobot.datasets.lerobot_dataset import LeRobotDataset as D; "
        f"d = D('{repo}'); print(d.num_episodes, len([d[i] for i in range(0, len(d), 7)]))"
    )
    yield Call("LeRobotDataset", _python(loaded), lambda out: _said(out, f"{len(ids)} "))
    whole = (
        f"import datasets; d = datasets.load_dataset('{root}'); "
        "print(len(set(d['train']['episode_index'])), 'episodes')"
    )
    yield Call("datasets.load_dataset", _python(whole), lambda out: _said(out, f"{len(ids)} ep"))
    edit = [_script("lerobot-edit-dataset"), "--repo_id", repo]
    yield Call(
        "lerobot-edit-dataset split",
        [*edit, "--operation.type", "split", "--operation.splits", '{"a": [0, 2], "b": [1]}'],
        lambda _: f"{_holds(home, name + '_a', ids[:3:2])}; {_holds(home, name + '_b', ids[1:2])}",
    )
    parts = [f"{repo}_a", f"{repo}_b"]
    yield Call(
        "lerobot-edit-dataset merge",
        [edit[0], "--repo_id", f"{repo}_joined", "--operation.type", "merge",
         "--operation.repo_ids", str(parts)],
        lambda _: _holds(home, f"{name}_joined", [ids[0], ids[2], ids[1]]),
    )  # fmt: skip
    joined = (
        "from lerobot.datasets.aggregate import aggregate_datasets; "
        f"aggregate_datasets({parts}, '{repo}_aggregated')"
    )
    yield Call(
        "aggregate_datasets",
        _python(joined),
        lambda _: _holds(home, f"{name}_aggregated", [ids[0], ids[2], ids[1]]),
    )
    yield Call(
        "lerobot-edit-dataset delete",
        [*edit, "--new_repo_id", f"{repo}_fewer", "--operation.type", "delete_episodes",
         "--operation.episode_indices", "[0]"],
        lambda _: _holds(home, f"{name}_fewer", ids[1:]),
    )  # fmt: skip
    thrown = "annotation.labels"
    if name == "portable":
        thrown = next(
            path.name for path in sorted((root / "videos").iterdir())
        )  # a camera, as in LeRobot's own example
    yield Call(
        "lerobot-edit-dataset remove",
        [*edit, "--new_repo_id", f"{repo}_thin", "--operation.type", "remove_feature",
         "--operation.feature_names", str([thrown])],
        lambda _: f"{_holds(home, name + '_thin', ids)}, without {thrown}",
    )  # fmt: skip
    yield Call(
        "lerobot-dataset-viz --save",
        [_script("lerobot-dataset-viz"), "--repo-id", repo, "--episode-index", "0", "--save", "1",
         "--output-dir", str(home / "viz")],
        lambda _: _sizes((home / "viz").glob(f"*{name}_episode_0.rrd")),
    )  # fmt: skip
    for policy in POLICIES if name == "portable" else ():
        out = home / "trained" / policy
        yield Call(
            f"lerobot-train {policy}",
            [_script("lerobot-train"), f"--dataset.repo_id={repo}", f"--policy.type={policy}",
             *(["--policy.pretrained_backbone_weights=null"] if policy == "act" else []),
             "--policy.push_to_hub=false", "--policy.device=cpu", f"--output_dir={out}",
             f"--steps={steps}", "--batch_size=2", "--num_workers=0", "--log_freq=1"],
            functools.partial(_trained, out),
        )  # fmt: skip


def recording_calls(bags: Path, run: Path) -> Iterator[Call]:
    """Commands for rosbag2 exports and for the raw logs of a run."""
    read = (
        "import sys, pathlib; from rosbags.highlevel import AnyReader\n"
        f"for folder in sorted(p.parent for p in pathlib.Path('{bags}').glob('*/metadata.yaml')):\n"
        "    with AnyReader([folder]) as reader:\n"
        "        found = [reader.deserialize(m, c.msgtype) for c, _, m in reader.messages()]\n"
        "        print(len(found), 'messages of', len(reader.topics), 'topics')"
    )
    yield Call("rosbags AnyReader", _python(read), lambda out: _said(out, " messages of"))
    log = next(run.glob("episodes/*/episode.mcap"))
    decoded = (
        "from mcap_ros2.reader import read_ros2_messages\n"
        f"found = [m.channel.topic for m in read_ros2_messages('{log}')]\n"
        "print(len(found), 'messages of', len(set(found)), 'topics')"
    )
    yield Call(
        "Foxglove's mcap_ros2", _python(decoded), lambda out: _said(out, " messages of")
    )  # decodes by the schemas in the file


def _chosen(calls: Iterable[Call], only: Sequence[str]) -> Iterator[Call]:
    yield from (c for c in calls if not only or any(word in c.name for word in only))


def _run(call: Call, profile: str, environment: dict[str, str], folder: Path) -> Outcome:
    started = time.perf_counter()
    done = subprocess.run(
        call.command, env=environment, cwd=folder, capture_output=True, text=True,
        timeout=TIMEOUT_S, check=False,
    )  # fmt: skip
    seconds = time.perf_counter() - started
    aborted = done.returncode != 0 and ABORTED in done.stderr
    if done.returncode and not aborted:
        said = done.stderr.strip().rpartition("\n")[2]
        return Outcome(call.name, profile, seconds, done.returncode, said, False)
    try:
        result = call.check(done.stdout)
    except Exception as error:  # whatever is wrong with a result is what the table tells
        said = f"{type(error).__name__}: {error}"
        return Outcome(call.name, profile, seconds, done.returncode, said, False)
    if aborted:
        result += "; aborted while Python ended"
    return Outcome(call.name, profile, seconds, done.returncode, result, True)


def _python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def _script(name: str) -> str:
    return str(Path(sys.executable).with_name(name))


def _said(output: str, expected: str) -> str:
    last = output.strip().rpartition("\n")[2]
    if expected not in last:
        raise ValueError(f"expected '{expected.strip()}', it said '{last}'")
    return last


def _holds(home: Path, name: str, ids: Sequence[str]) -> str:
    """Check a dataset that a tool made; say what it holds."""
    root = home / "me" / name
    if findings := list(validate(root)):
        raise ValueError(f"{findings[0].where}: {findings[0].what}")
    if (found := list(read_episodes(root).ids)) != list(ids):
        raise ValueError(f"expected episodes {', '.join(ids)}, it holds {', '.join(found)}")
    return f"{len(found)} episodes, nothing wrong"


def _trained(out: Path, _: str) -> str:
    return _sizes(out.glob("checkpoints/last/pretrained_model/*.safetensors"))


def _sizes(files: Iterable[Path]) -> str:
    """Names and sizes of what a tool wrote."""
    found = [f"{path.name} {path.stat().st_size / 1e6:.1f} MB" for path in sorted(files)]
    if not found:
        raise ValueError("it wrote no file")
    return ", ".join(found)


def _main() -> None:
    options, works = tyro.cli(Options), []
    with tempfile.TemporaryDirectory(prefix="codediffuser-tools-") as folder:
        for outcome in run_tools(options, Path(folder)):
            works.append(outcome.works)
            sys.stdout.write(f"{outcome}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{sum(works)} of {len(works)} commands work\n")
    sys.exit(0 if all(works) else 1)


if __name__ == "__main__":
    _main()
