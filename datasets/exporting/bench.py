"""Export speed beside LeRobot's own writer, in turns in one run.

python -m codediffuser.datasets.exporting.bench RUN --num-episodes 2

All sides read the same episodes from their logs and write the same features. `lerobot` is its
documented recording loop with every setting at its default: a frame's pictures are written one by
one as PNG, then a process per camera encodes as AV1. `streaming` is the same with
`streaming_encoding=True`, where encoders take the pictures as they come. With another `--codec` on
our side, size and fidelity of the videos tell whether the comparison is fair. Each turn is a
process of its own, whose memory is watched from outside.
"""

from __future__ import annotations

import functools
import os
import shutil
import statistics
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.exporting.format import ExportOptions
from codediffuser.datasets.exporting.formats.lerobot import LeRobotFormat
from codediffuser.datasets.exporting.pictures import mask_bits, png_text
from codediffuser.datasets.exporting.source import Source, labels_json, program_text
from codediffuser.datasets.exporting.video import ENCODERS, Codec, VideoConfig, count_frames
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
from codediffuser.measuring import Turn, print_measured, take_turn

LIBRARIES = (
    "av", "codediffuser.datasets.exporting.formats", "codediffuser.labeling.language.composer",
    "cv2", "lerobot.datasets.lerobot_dataset", "matplotlib.backends.backend_agg", "pandas",
)  # fmt: skip
"""Loaded before a turn's clock starts."""
JUDGED_EVERY = 10
"""Of how many pictures one is compared with what was recorded."""


@dataclass(kw_only=True)
class Options:
    """Export some episodes of a run, by this toolkit and by LeRobot's writer."""

    run: tyro.conf.Positional[Path]
    """A run with labelled episodes."""
    num_episodes: int = 2
    profile: Literal["portable", "masked-rgb"] = "portable"
    codec: Codec = "av1"
    """Of our side."""
    lerobot_codec: Codec = "av1"
    """Of LeRobot's; `av1` is its default."""
    workers: int = 1
    """Processes of our side. LeRobot's encodes by one per camera. All sides' encoders have threads
    of their own."""
    rounds: int = 3
    """How often each side has its turn."""
    streaming: bool = True
    """Whether LeRobot's writer has turns with `streaming_encoding`, too."""


def measure(options: Options, scratch: Path) -> str:
    """Time all sides in turns and say what came out.

    Raises:
        DatasetError: Our side lost a frame, or LeRobot's by default did.
    """
    run = _copy_run(options, scratch / "run")
    folders = list_episodes(run)
    frames = sum(Source(folder).episode.num_frames for folder in folders)
    sides: dict[str, Callable[[Path, Path, Options], None]] = {"ours": _ours, "lerobot": _lerobot}
    if options.streaming:
        sides["streaming"] = functools.partial(_lerobot, streaming=True)
    turns: dict[str, list[Turn]] = {side: [] for side in sides}
    lost = dict.fromkeys(sides, 0)
    for _ in range(options.rounds):
        for side, work in sides.items():
            out = scratch / side
            for folder in (out, run / ".cache"):
                shutil.rmtree(folder, ignore_errors=True)
            turns[side].append(take_turn(work, (run, out, options), LIBRARIES))
            sys.stderr.write(f"{side}: {turns[side][-1].wall_s:.2f} s\n")
            lost[side] += _lost_pictures(out, frames)
            if lost[side] and side != "streaming":
                raise DatasetError(f"{side}: {lost[side]} pictures are missing")
    camera = Source(folders[0]).cameras[0]
    lines = [
        f"{options.profile}, ours {options.codec}, LeRobot's {options.lerobot_codec}, "
        f"{len(folders)} episodes, {frames} camera sets of "
        f"{len(Source(folders[0]).cameras)} x {camera.width} x {camera.height}; medians of "
        f"{options.rounds} rounds; ours: {options.workers} process(es)"
    ]
    for side in sides:
        lines.append(
            f"{side:9} {_line(turns[side], turns['ours'], frames)}  lost {lost[side]}  "
            f"videos {_videos(scratch / side, folders, options)}"
        )
    return "\n".join(lines)


def _line(mine: Sequence[Turn], ours: Sequence[Turn], frames: int) -> str:
    wall, cpu = (statistics.median(getattr(t, n) for t in mine) for n in ("wall_s", "cpu_s"))
    times = statistics.median(b.wall_s / a.wall_s for a, b in zip(ours, mine, strict=True))
    works = statistics.median(b.cpu_s / a.cpu_s for a, b in zip(ours, mine, strict=True))
    return (
        f"{frames / wall:6.1f} camera-sets/s  {wall:6.2f} s = {times:4.2f} x ours  "
        f"cpu {cpu:6.2f} s = {works:4.2f} x ours  peak {max(t.peak_mb for t in mine):5.0f} MB"
    )


def _videos(root: Path, folders: list[Path], options: Options) -> str:
    """Size of a side's videos, and how near their pictures are to those that were recorded."""
    size = sum(path.stat().st_size for path in root.rglob("*.mp4")) / 1e6
    if options.profile != "portable":
        return f"{size:.2f} MB"
    episode = Episode.open(folders[0])
    errors = []
    for camera in episode.manifest.cameras:
        recorded = (frame.rgb[camera.name] for frame in episode.frames([camera.name], depth=False))
        video = min((root / "videos" / image_key(camera.name)).rglob("*.mp4"))
        for k, (a, b) in enumerate(zip(recorded, _decoded(video), strict=False)):
            if k % JUDGED_EVERY == 0:
                errors.append(np.mean((a.astype(np.float64) - b) ** 2))
    return f"{size:.2f} MB, {10 * np.log10(255**2 / np.mean(errors)):.1f} dB"


def _decoded(video: Path) -> Iterator[np.ndarray]:
    import av

    with av.open(str(video)) as container:
        for picture in container.decode(video=0):
            yield picture.to_ndarray(format="rgb24")


def _copy_run(options: Options, target: Path) -> Path:
    chosen = list_episodes(options.run)[: options.num_episodes]
    for folder in chosen:
        shutil.copytree(folder, target / "episodes" / folder.name)
    return target


def _ours(run: Path, out: Path, options: Options) -> None:
    video = VideoConfig(codec=options.codec)
    for _ in convert_run(run, out, profile=options.profile, video=video, workers=options.workers):
        pass


def _lerobot(run: Path, out: Path, options: Options, *, streaming: bool = False) -> None:
    """LeRobot's recording loop as its documentation writes it."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    os.environ["HF_HUB_OFFLINE"] = "1"
    folders = list_episodes(run)
    made = LeRobotFormat(ExportOptions(profile=options.profile), labelled=True)
    first = Source(folders[0])
    declared = {k: f.declaration() for k, f in made.features(first.manifest).items()}
    features = {
        key: {"dtype": f["dtype"], "shape": tuple(f["shape"]), "names": f["names"]}
        for key, f in declared.items()
    }
    dataset = LeRobotDataset.create(
        "local/bench", first.manifest.hz, features, root=out,
        vcodec=ENCODERS[options.lerobot_codec], streaming_encoding=streaming,
    )  # fmt: skip
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
            row[depth_key(name)] = png_text(frame.depth_mm[name])
            row[mask_key(name)] = png_text(mask_bits(masks))
            row[intrinsics_key(name)] = camera.K.reshape(9).astype(np.float32)
            row[pose_key(name)] = camera.T_world_camera.reshape(16).astype(np.float32)
        yield row


def _lost_pictures(root: Path, frames: int) -> int:
    """How many pictures the videos of all cameras lack together."""
    found = [
        sum(count_frames(path) for path in folder.rglob("*.mp4"))
        for folder in sorted((root / "videos").iterdir())
    ]
    return len(found) * frames - sum(found)


if __name__ == "__main__":
    print_measured(Options, measure)
