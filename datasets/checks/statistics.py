"""Are the statistics that policies normalise by those of the data?"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode_check import Finding
from codediffuser.datasets.checks.numbers import REMEDY
from codediffuser.datasets.checks.rows import EpisodeRows
from codediffuser.datasets.export_meta import STATS
from codediffuser.datasets.features import ACTION, POINT_CHANNELS, POINTS, STATE
from codediffuser.datasets.stats import QUANTILES, STEP, Stats, feature_stats, merge_stats

JUDGED = (POINTS, STATE, ACTION)
TOLERANCE = 1e-4
"""Relative to a column's range: float32 sums in other orders."""


def stats_of(episode: EpisodeRows) -> dict[str, Stats]:
    """Statistics of one episode; points have one set per channel."""
    found = {}
    for key in JUDGED:
        if key in episode.columns and episode.length:
            values, size = episode.columns[key], len(POINT_CHANNELS)
            per_row = values.reshape(-1, size) if key == POINTS else values
            found[key] = feature_stats(per_row, count=episode.length)
    return found


def check_stats(root: Path, parts: Sequence[dict[str, Stats]]) -> Iterator[Finding]:
    """Compare `meta/stats.json` with the statistics of all episodes."""
    path = root / STATS
    try:
        written = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        yield Finding("dataset.stats", str(path), f"not readable: {error}", REMEDY)
        return
    for key in JUDGED:
        own = [part[key] for part in parts if key in part]
        if not own:
            continue
        expected = merge_stats(own)
        scale = np.maximum(expected["max"] - expected["min"], 1e-3)
        for name, value in expected.items():
            found = np.asarray(written.get(key, {}).get(name, []), dtype=np.float64)
            tolerance = 0.0 if name == "count" else TOLERANCE * scale
            if name in QUANTILES:
                # Convert knows those of all frames, LeRobot's tools average those of episodes.
                low, high = expected["min"] - STEP, expected["max"] + STEP
                sound = found.shape == value.shape and ((low <= found) & (found <= high)).all()
            else:
                sound = found.shape == value.shape and (np.abs(found - value) <= tolerance).all()
            if not sound:
                what = f"{key}/{name} is not that of the data: {found.round(4)}, {value.round(4)}"
                yield Finding("dataset.stats", str(path), what, REMEDY)
