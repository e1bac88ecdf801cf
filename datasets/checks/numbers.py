"""Are the numbers of an episode possible? Order, times, finite values, motion, clouds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from codediffuser.datagen.episode_check import Finding
from codediffuser.datagen.trajectory import ACTION_NAMES
from codediffuser.datasets.checks.rows import SCALARS, EpisodeRows
from codediffuser.datasets.features import ACTION, POINT_CHANNELS, POINTS
from codediffuser.errors import CodeDiffuserError
from codediffuser.poses import rot6d_to_matrix

MAX_SPEED_MPS = 2.5
"""A commanded hand that moves faster jumps: the expert reaches 0.6 m/s."""
MAX_SPIN_RADPS = 12.0
MAX_REACH_M = 3.0
"""Points farther from the world's origin are misread."""
REMEDY = "run `codediffuser convert RUN` again"
LOOK = "look at the demonstration; delete or record it again"


def check_order(episode: EpisodeRows, fps: int) -> Iterator[Finding]:
    """Frames are counted from 0, and time goes by evenly."""
    declared = int(episode.meta["length"])
    if episode.length != declared:
        what = f"expected {declared} frames, found {episode.length}"
        yield Finding("dataset.frames-missing", episode.where, what, REMEDY)
    frame = np.arange(episode.length)
    expected = {
        "episode_index": np.full(len(frame), int(episode.meta["episode_index"])),
        "index": int(episode.meta["dataset_from_index"]) + frame,
        "frame_index": frame,
        "timestamp": frame / fps,
    }
    for key, values in expected.items():
        found = episode.scalar(key)
        wrong = np.flatnonzero(~np.isclose(found, values, rtol=0, atol=1e-4))
        if len(wrong):
            k = wrong[0]
            kind = "dataset.time" if key == "timestamp" else "dataset.row-numbers"
            what = f"{key} of frame {k}: expected {values[k]}, found {found[k]}"
            yield Finding(kind, episode.where, what, REMEDY)


def check_finite(episode: EpisodeRows) -> Iterator[Finding]:
    """No NaN and no infinity in any column."""
    for key, values in episode.columns.items():
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if key not in SCALARS and len(bad):
            what = f"{key} of frame {bad[0]} is not finite ({len(bad)} such frames)"
            yield Finding("dataset.not-finite", episode.where, what, REMEDY)


def check_motion(episode: EpisodeRows, fps: int, names: list[str] | None) -> Iterator[Finding]:
    """Commanded hand poses do not jump; actions that are something else are not judged."""
    if names != list(ACTION_NAMES):
        return
    found = episode.columns[ACTION]
    action = found[np.isfinite(found).all(axis=1)].astype(np.float64)
    speed = np.linalg.norm(np.diff(action[:, :3], axis=0), axis=1) * fps
    try:
        R = rot6d_to_matrix(action[:, 3:9])
    except CodeDiffuserError as error:
        yield Finding("dataset.rotation", episode.where, f"{ACTION}: {error}", LOOK)
        return
    cosine = (np.einsum("tij,tij->t", R[:-1], R[1:]) - 1) / 2
    spin = np.arccos(np.clip(cosine, -1, 1)) * fps
    for unit, values, limit in (
        ("m/s", speed, MAX_SPEED_MPS),
        ("rad/s", spin, MAX_SPIN_RADPS),
    ):
        if len(values) and values.max() > limit:
            k = int(values.argmax())
            what = f"{ACTION} jumps at frame {k + 1}: {values[k]:.1f} {unit}, expected <= {limit}"
            yield Finding("dataset.action-jump", episode.where, what, LOOK)


def check_clouds(episode: EpisodeRows) -> Iterator[Finding]:
    """Points lie near, attention is a share, and each frame attends to something."""
    if POINTS not in episode.columns:
        return
    points = episode.columns[POINTS].reshape(episode.length, -1, len(POINT_CHANNELS))
    far = np.flatnonzero(np.abs(points[..., :3]).max(axis=(1, 2), initial=0) > MAX_REACH_M)
    if len(far):
        what = f"points of frame {far[0]} lie more than {MAX_REACH_M} m from the origin"
        remedy = "check units and camera poses of the episode"
        yield Finding("dataset.far-points", episode.where, what, remedy)
    attention = points[..., 3:]
    if ((attention < 0) | (attention > 1)).any():
        what = "attention outside 0 to 1"
        yield Finding("dataset.attention-range", episode.where, what, REMEDY)
    for channel, name in enumerate(POINT_CHANNELS[3:]):
        empty = np.flatnonzero(~(attention[..., channel] > 0).any(axis=1))
        if len(empty):
            what = f"{name}: no attended point in {len(empty)} frames, first {empty[0]}"
            remedy = "check the episode's labels, then convert again"
            yield Finding("dataset.no-attention", episode.where, what, remedy)
