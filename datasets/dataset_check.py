"""Judges a LeRobot folder of the `pointcloud` profile: every finding says where, what, what to do.

It reads every number once and keeps one episode in memory.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.datagen.episode_check import Finding
from codediffuser.datagen.trajectory import ACTION_NAMES
from codediffuser.datasets import parquet_reader
from codediffuser.datasets.export_meta import (
    DATA,
    INFO,
    STATS,
    dataset_fingerprint,
    find_document,
    load_info,
)
from codediffuser.datasets.features import ACTION, POINT_CHANNELS, POINTS, STATE, STATE_NAMES
from codediffuser.datasets.stats import QUANTILES, Stats, feature_stats, merge_stats
from codediffuser.datasets.stats import STEP as POINT_STEP
from codediffuser.errors import CodeDiffuserError
from codediffuser.poses import rot6d_to_matrix

MAX_SPEED_MPS = 2.5
"""A commanded hand that moves faster jumps: the expert reaches 0.6 m/s."""
MAX_SPIN_RADPS = 12.0
MAX_REACH_M = 3.0
"""Points and hands farther from the world's origin are misread."""
STATS_TOLERANCE = 1e-4
"""Relative to a column's range: float32 sums in other orders."""
REMEDY = "run `codediffuser convert RUN` again"


def check_dataset(root: Path) -> Iterator[Finding]:
    """Check declarations, counts, times, values, statistics and hashes of one dataset.

    Yields:
        What is wrong; nothing for a good dataset. Checks stop early when the files cannot be read.

    Raises:
        DatasetError: There is no LeRobot dataset at `root`.
        SchemaVersionError: Its document is of a version that this code cannot read.
    """
    info, document = load_info(root), find_document(root)
    try:
        yield from _check_info(root, info)
        rows = parquet_reader.read_episode_rows(root)
        yield from _check_counts(root, info, rows)
        stats: list[dict[str, Stats]] = []
        for episode in _episodes(root, info, rows):
            yield from _check_times(episode, info["fps"])
            yield from _check_values(episode)
            yield from _check_motion(episode, info["fps"])
            stats.append(_stats(episode))
        yield from _check_stats(root, stats)
    except CodeDiffuserError as error:
        yield Finding(str(root), str(error), REMEDY)
        return
    if document is not None and dataset_fingerprint(root) != document.content_sha256:
        yield Finding(str(root), "the files are not those that convert wrote", REMEDY)


@dataclass(frozen=True, slots=True)
class _Episode:
    """The numbers of one episode of T frames."""

    where: str
    index: int
    first: int
    points: np.ndarray
    """(T, N, 5)."""
    state: np.ndarray
    action: np.ndarray
    columns: dict[str, np.ndarray]
    """LeRobot's own columns, (T,) each."""


def _check_info(root: Path, info: dict[str, Any]) -> Iterator[Finding]:
    where = str(root / INFO)
    size = parquet_reader.points_size(root, info)
    if size == 0 or size % len(POINT_CHANNELS):
        what = f"{POINTS} has {size} numbers, not {len(POINT_CHANNELS)} for each point"
        yield Finding(where, what, REMEDY)
    for key, names in ((STATE, STATE_NAMES), (ACTION, ACTION_NAMES)):
        shape = info["features"][key]["shape"]
        if list(shape) != [len(names)]:
            yield Finding(where, f"{key}: expected shape [{len(names)}], found {shape}", REMEDY)


def _check_counts(
    root: Path, info: dict[str, Any], rows: list[dict[str, Any]]
) -> Iterator[Finding]:
    frames = sum(int(row["length"]) for row in rows)
    tasks = len({task for row in rows for task in row["tasks"]})
    for key, found in (
        ("total_episodes", len(rows)),
        ("total_frames", frames),
        ("total_tasks", tasks),
    ):
        if info.get(key) != found:
            what = f"{key} is {info.get(key)}, the episodes have {found}"
            yield Finding(str(root / INFO), what, REMEDY)


def _episodes(root: Path, info: dict[str, Any], rows: list[dict[str, Any]]) -> Iterator[_Episode]:
    """Cut the stream of frames into the episodes that the metadata names."""
    scalars = ("timestamp", "frame_index", "episode_index", "index")
    sizes = {POINTS: parquet_reader.points_size(root, info), STATE: 10, ACTION: 10}
    sizes |= dict.fromkeys(scalars, 1)
    stream = parquet_reader.read_frames(root, sizes)
    held: dict[str, np.ndarray] = {key: np.zeros((0, n), np.float32) for key, n in sizes.items()}
    for row in rows:
        length = int(row["length"])
        while len(held[STATE]) < length:
            batch = next(stream, None)
            if batch is None:
                break
            held = {key: np.concatenate([held[key], batch[key]]) for key in sizes}
        part = {key: values[:length] for key, values in held.items()}
        held = {key: values[length:] for key, values in held.items()}
        yield _Episode(
            where=f"{root / DATA.split('/')[0]}, episode {row['episode_index']}",
            index=int(row["episode_index"]),
            first=int(row["dataset_from_index"]),
            points=part[POINTS].reshape(len(part[POINTS]), -1, len(POINT_CHANNELS)),
            state=part[STATE],
            action=part[ACTION],
            columns={key: part[key][:, 0] for key in scalars},
        )


def _check_times(episode: _Episode, fps: int) -> Iterator[Finding]:
    frame = np.arange(len(episode.state))
    expected = {
        "episode_index": np.full(len(frame), episode.index),
        "index": episode.first + frame,
        "frame_index": frame,
        "timestamp": frame / fps,
    }
    for key, values in expected.items():
        wrong = np.flatnonzero(~np.isclose(episode.columns[key], values, rtol=0, atol=1e-4))
        if len(wrong):
            k = wrong[0]
            what = f"{key} of frame {k}: expected {values[k]}, found {episode.columns[key][k]}"
            yield Finding(episode.where, what, REMEDY)


def _check_values(episode: _Episode) -> Iterator[Finding]:
    for key, values in (
        (POINTS, episode.points),
        (STATE, episode.state),
        (ACTION, episode.action),
    ):
        bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        if len(bad):
            what = f"{key} of frame {bad[0]} is not finite ({len(bad)} such frames)"
            yield Finding(episode.where, what, REMEDY)
    far = np.flatnonzero(np.abs(episode.points[..., :3]).max(axis=(1, 2), initial=0) > MAX_REACH_M)
    if len(far):
        what = f"points of frame {far[0]} lie more than {MAX_REACH_M} m from the origin"
        yield Finding(episode.where, what, "check units and camera poses of the episode")
    attention = episode.points[..., 3:]
    if ((attention < 0) | (attention > 1)).any():
        yield Finding(episode.where, "attention outside 0 to 1", REMEDY)
    for channel, name in enumerate(POINT_CHANNELS[3:]):
        empty = np.flatnonzero(~(attention[..., channel] > 0).any(axis=1))
        if len(empty):
            what = f"{name}: no attended point in {len(empty)} frames, first {empty[0]}"
            yield Finding(episode.where, what, "check the episode's labels, then convert again")


def _check_motion(episode: _Episode, fps: int) -> Iterator[Finding]:
    action = episode.action[np.isfinite(episode.action).all(axis=1)].astype(np.float64)
    remedy = "look at the demonstration; delete or record it again"
    speed = np.linalg.norm(np.diff(action[:, :3], axis=0), axis=1) * fps
    try:
        R = rot6d_to_matrix(action[:, 3:9])
    except CodeDiffuserError as error:
        yield Finding(episode.where, f"{ACTION}: {error}", remedy)
        return
    cosine = (np.einsum("tij,tij->t", R[:-1], R[1:]) - 1) / 2
    spin = np.arccos(np.clip(cosine, -1, 1)) * fps
    for what, values, limit in (
        ("m/s", speed, MAX_SPEED_MPS),
        ("rad/s", spin, MAX_SPIN_RADPS),
    ):
        if len(values) and values.max() > limit:
            k = int(values.argmax())
            yield Finding(
                episode.where,
                f"{ACTION} jumps at frame {k + 1}: {values[k]:.1f} {what}, expected <= {limit}",
                remedy,
            )


def _stats(episode: _Episode) -> dict[str, Stats]:
    per_point = episode.points.reshape(-1, len(POINT_CHANNELS))
    return {
        POINTS: feature_stats(per_point, count=len(episode.state)),
        STATE: feature_stats(episode.state),
        ACTION: feature_stats(episode.action),
    }


def _check_stats(root: Path, parts: list[dict[str, Stats]]) -> Iterator[Finding]:
    path = root / STATS
    try:
        written = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        yield Finding(str(path), f"not readable: {error}", REMEDY)
        return
    for key in (POINTS, STATE, ACTION):
        expected = merge_stats([part[key] for part in parts])
        scale = np.maximum(expected["max"] - expected["min"], 1e-3)
        for name, value in expected.items():
            found = np.asarray(written.get(key, {}).get(name, []), dtype=np.float64)
            tolerance = 0.0 if name == "count" else STATS_TOLERANCE * scale
            if name in QUANTILES:
                # Convert knows those of all frames, LeRobot's tools average those of episodes.
                low, high = expected["min"] - POINT_STEP, expected["max"] + POINT_STEP
                sound = found.shape == value.shape and ((low <= found) & (found <= high)).all()
            else:
                sound = found.shape == value.shape and (np.abs(found - value) <= tolerance).all()
            if not sound:
                what = f"{key}/{name} is not that of the data: {found.round(4)}, {value.round(4)}"
                yield Finding(str(path), what, REMEDY)
