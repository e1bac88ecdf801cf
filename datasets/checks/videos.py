"""Do the pictures of a dataset fit its rows? Counts, times, black and frozen stretches."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np

from codediffuser.datagen.episode_check import BLACK, FROZEN_S, Finding, longest_repeat
from codediffuser.datasets.checks.numbers import REMEDY
from codediffuser.datasets.export_meta import VIDEO

MASKED_SHARE = 0.8
"""Of a picture that shows what is attended alone, at least so much is black."""
THUMB = 4
"""Every how many pixels are looked at: a black or frozen picture is so everywhere."""
SAME = 8
"""Grey values by which encoders let pictures of the same thing differ."""
DEAD_SHARE = 0.5
"""A camera that looks past the robot may well show nothing new for less of an episode."""
MOVED = 0.3
"""A robot that crosses this share of an episode's range of states would be seen."""


def check_videos(
    root: Path, videos: Sequence[str], rows: Sequence[dict[str, Any]], fps: int,
    states: Mapping[int, np.ndarray], *, masked: bool | None = False,
) -> Iterator[Finding]:  # fmt: skip
    """Decode every video once and judge each episode's stretch of it.

    Args:
        root: Dataset.
        videos: Names of its video features.
        rows: Of `meta/episodes`.
        fps: Frames per second.
        states: (T, D) of each episode: a picture may stay the same while the robot stands still.
        masked: Whether pictures show what is attended alone: those are black while it is hidden,
            and neither black nor frozen ones are told. None judges each video by its pictures.
    """
    for key in videos:
        by_file: dict[Path, list[dict[str, Any]]] = {}
        for row in rows:
            at = (row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"])
            path = root / VIDEO.format(video_key=key, chunk_index=at[0], file_index=at[1])
            by_file.setdefault(path, []).append(row)
        for path, held in by_file.items():
            yield from _check_file(path, key, held, fps, states, masked)


def _check_file(
    path: Path, key: str, rows: list[dict[str, Any]], fps: int,
    states: Mapping[int, np.ndarray], masked: bool | None,
) -> Iterator[Finding]:  # fmt: skip
    try:
        times, pictures = _decode(path)
    except (av.FFmpegError, OSError, IndexError) as error:
        what = f"not readable ({type(error).__name__}: {error})"
        yield Finding("video.unreadable", str(path), what, REMEDY)
        return
    if len(times) > 1 and np.abs(np.diff(times) - 1 / fps).max() > 0.25 / fps:
        what = f"pictures do not follow one another every 1/{fps} s"
        yield Finding("video.time", str(path), what, REMEDY)
    if masked is None:
        masked = _looks_masked(pictures)
    for row in rows:
        start = float(row[f"videos/{key}/from_timestamp"])
        stop = float(row[f"videos/{key}/to_timestamp"])
        length, where = int(row["length"]), f"{path}, episode {row['episode_index']}"
        own = (times >= start - 0.5 / fps) & (times < start + (length - 0.5) / fps)
        if int(own.sum()) != length or abs(stop - start - length / fps) > 0.5 / fps:
            what = f"expected {length} pictures from {start:.2f} s on, found {int(own.sum())}"
            yield Finding("video.length", where, what, REMEDY)
            continue
        if not masked:
            yield from _check_pictures(where, pictures[own], fps, states[int(row["episode_index"])])


def _looks_masked(pictures: np.ndarray) -> bool:
    """Whether the pictures (F, h, w) that are not black are so but for a small part of each."""
    dark = pictures.reshape(len(pictures), -1) < BLACK
    lit = dark[~dark.all(axis=1)]
    return bool(len(lit)) and float(np.median(lit.mean(axis=1))) > MASKED_SHARE


def _check_pictures(where: str, seen: np.ndarray, fps: int, state: np.ndarray) -> Iterator[Finding]:
    remedy = "check the camera; record the episode again"
    black = np.flatnonzero(seen.reshape(len(seen), -1).max(axis=1) < BLACK)
    if len(black):
        what = f"{len(black)} black pictures, first {black[0]}"
        yield Finding("video.black", where, what, remedy)
    first, count = longest_repeat(
        [np.abs(b.astype(int) - a).max() <= SAME for a, b in itertools.pairwise(seen)]
    )
    stretch = np.ptp(state[first : first + count], axis=0) / np.maximum(np.ptp(state, axis=0), 1e-6)
    if count > max(FROZEN_S * fps, DEAD_SHARE * len(seen)) and stretch.max() > MOVED:
        what = f"the same picture {count} times in a row from frame {first} on, while it moved"
        yield Finding("video.frozen", where, what, remedy)


def _decode(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times (F,) in s and coarse grey pictures (F, h, w) uint8 of a whole file."""
    times, pictures = [], []
    with av.open(str(path)) as container:
        for frame in container.decode(container.streams.video[0]):
            times.append(float(frame.time or 0.0))
            pictures.append(frame.to_ndarray(format="gray")[::THUMB, ::THUMB])
    return np.array(times), np.stack(pictures)
