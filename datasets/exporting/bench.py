"""Export speed beside LeRobot's own writer with its default settings, in turns in one run.

python -m codediffuser.datasets.exporting.bench RUN --num-episodes 2

Both sides read the same episodes from their logs and write the same features with the same codec
and quality. LeRobot's side is its documented recording loop with every setting at its default: a
frame's pictures are written one by one, then a process per camera encodes. Each turn is a process
of its own, so that its peak memory can be told.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import shutil
import signal
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from codediffuser.datagen.episode import list_episodes
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.exporting.format import ExportOptions
from codediffuser.datasets.exporting.formats.lerobot import LeRobotFormat
from codediffuser.datasets.exporting.pictures import depth_millimetres, mask_bits, png_text
from codediffuser.datasets.exporting.source import Source, labels_json, program_text
from codediffuser.datasets.exporting.video import count_frames
from codediffuser.datasets.features import (
    ACTION,
    EPISODE_ID,
    LABELS,
    PROGRAM,
    STATE,
    depth_key,
    image_key,
    intrinsics_key,
    mask_key,
    pose_key,
)
from codediffuser.errors import DatasetError
from codediffuser.measuring import print_measured

TIMEOUT_S = 3600.0
"""For one turn; a longer one is taken for hung."""


@dataclass(kw_only=True)
class Options:
    """Export some episodes of a run, by this toolkit and by LeRobot's writer."""

    run: tyro.conf.Positional[Path]
    """A run with labelled episodes."""
    num_episodes: int = 2
    profile: Literal["portable", "masked-rgb"] = "portable"
    workers: int = 1
    """Processes of our side. LeRobot's encodes by one per camera. Both sides' encoders have threads
    of their own."""
    rounds: int = 3
    """How often each side has its turn."""


@dataclass(frozen=True, slots=True)
class Turn:
    """What one turn took."""

    wall_s: float
    cpu_s: float
    """Of all processes."""
    peak_mb: float
    """Largest resident memory of any one process."""


def measure(options: Options, scratch: Path) -> str:
    """Time both sides in turns and say what came out.

    Raises:
        DatasetError: A side lost a frame.
    """
    run = _copy_run(options, scratch / "run")
    folders = list_episodes(run)
    frames = sum(Source(folder).episode.num_frames for folder in folders)
    turns: dict[str, list[Turn]] = {"ours": [], "lerobot": []}
    for _ in range(options.rounds):
        for side, work in (("ours", _ours), ("lerobot", _lerobot)):
            out = scratch / side
            shutil.rmtree(out, ignore_errors=True)
            turns[side].append(_in_own_process(work, run, out, options))
            _check_frames(out, frames)
    ratio = statistics.median(
        b.wall_s / a.wall_s for a, b in zip(turns["ours"], turns["lerobot"], strict=True)
    )
    size = Source(folders[0]).cameras[0]
    lines = [
        f"profile {options.profile}, {len(folders)} episodes, {frames} camera sets of "
        f"{size.width} x {size.height}; ours: {options.workers} process(es); "
        "lerobot: its defaults, a process per camera encodes"
    ]
    for side, taken in turns.items():
        best = statistics.median(t.wall_s for t in taken)
        cpu = statistics.median(t.cpu_s for t in taken)
        peak = max(t.peak_mb for t in taken)
        lines.append(
            f"{side:8} {frames / best:7.1f} camera-sets/s   {best:6.2f} s   cpu {cpu:6.2f} s   "
            f"largest process {peak:5.0f} MB"
        )
    cpu_ratio = statistics.median(
        b.cpu_s / a.cpu_s for a, b in zip(turns["ours"], turns["lerobot"], strict=True)
    )
    lines.append(
        f"ratio    {ratio:7.2f}x   (median of {options.rounds} rounds; of processor time "
        f"{cpu_ratio:.2f}x)"
    )
    return "\n".join(lines)


def _copy_run(options: Options, target: Path) -> Path:
    chosen = list_episodes(options.run)[: options.num_episodes]
    for folder in chosen:
        shutil.copytree(folder, target / "episodes" / folder.name)
    return target


def _in_own_process(
    work: Callable[[Path, Path, Options], None], run: Path, out: Path, options: Options
) -> Turn:
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_turn, args=(sender, work, run, out, options))
    process.start()
    pid = process.pid
    assert pid is not None
    sender.close()
    try:
        if not receiver.poll(TIMEOUT_S):
            # And all that it has started: one of those may be what hangs.
            os.killpg(pid, signal.SIGKILL)
            raise DatasetError(f"{work.__name__}: no end after {TIMEOUT_S:.0f} s")
        turn: Turn = receiver.recv()
    except EOFError:
        raise DatasetError(f"{work.__name__}: its process ended without a result") from None
    process.join()
    return turn


def _turn(
    pipe: Any, work: Callable[[Path, Path, Options], None], run: Path, out: Path, options: Options
) -> None:
    os.setpgrp()
    work(run, out.with_name("warm"), _first_only(options))
    shutil.rmtree(out.with_name("warm"), ignore_errors=True)
    started, cpu = time.perf_counter(), _cpu_s()
    work(run, out, options)
    wall = time.perf_counter() - started
    peak = max(
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    pipe.send(Turn(wall, _cpu_s() - cpu, peak / 1024))


def _first_only(options: Options) -> Options:
    """Options of the turn that loads libraries; it is not measured."""
    return Options(run=options.run, num_episodes=1, profile=options.profile)


def _cpu_s() -> float:
    used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def _ours(run: Path, out: Path, options: Options) -> None:
    if options.num_episodes < len(list_episodes(run)):
        # The turn that loads libraries.
        some = out.with_name("some")
        shutil.rmtree(some, ignore_errors=True)
        run = _copy_run(Options(run=run, num_episodes=options.num_episodes), some)
    for _ in convert_run(run, out, profile=options.profile, workers=options.workers):
        pass


def _lerobot(run: Path, out: Path, options: Options) -> None:
    """LeRobot's recording loop as its documentation writes it, with default settings."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    os.environ["HF_HUB_OFFLINE"] = "1"
    folders = list_episodes(run)[: options.num_episodes]
    made = LeRobotFormat(ExportOptions(profile=options.profile), labelled=True)
    first = Source(folders[0])
    declared = {k: f.declaration() for k, f in made.features(first.manifest).items()}
    features = {
        key: {"dtype": f["dtype"], "shape": tuple(f["shape"]), "names": f["names"]}
        for key, f in declared.items()
    }
    dataset = LeRobotDataset.create("local/bench", first.manifest.hz, features, root=out)
    for folder in folders:
        source = Source(folder)
        for row in _rows(source, set(features)):
            dataset.add_frame({**row, "task": source.manifest.instruction})
        dataset.save_episode()
    dataset.finalize()


def _rows(source: Source, keys: set[str]) -> Any:
    """What a user would hand to `add_frame`: the same content, frame by frame."""
    episode = source.episode
    texts = {
        LABELS: labels_json(source.folder),
        PROGRAM: program_text(source.manifest.instruction, source.manifest.task),
        EPISODE_ID: episode.id,
    }
    state, actions = episode.state, episode.actions
    portable = any(key.startswith("depth.") for key in keys)
    for frame in episode.frames():
        row: dict[str, Any] = {STATE: state[frame.index], ACTION: actions[frame.index], **texts}
        for name, rgb in frame.rgb.items():
            masks = source.masks(frame, name)
            if not portable:
                row[image_key(name)] = rgb * np.asarray(masks.any(axis=0))[..., None]
                continue
            camera = source.camera_at(name, frame.index)
            row[image_key(name)] = rgb
            row[depth_key(name)] = png_text(depth_millimetres(frame.depth_m[name]))
            row[mask_key(name)] = png_text(mask_bits(masks))
            row[intrinsics_key(name)] = camera.K.reshape(9).astype(np.float32)
            row[pose_key(name)] = camera.T_world_camera.reshape(16).astype(np.float32)
        yield row


def _check_frames(root: Path, frames: int) -> None:
    """Raise unless every camera's videos hold every frame."""
    for folder in sorted((root / "videos").iterdir()):
        found = sum(count_frames(path) for path in folder.rglob("*.mp4"))
        if found != frames:
            raise DatasetError(f"{folder}: expected {frames} pictures, found {found}")


if __name__ == "__main__":
    print_measured(Options, measure)
