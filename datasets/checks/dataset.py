"""Judges a LeRobot folder of any profile: every finding says what kind, where, what, what to do.

It reads every number and picture once and keeps one episode, or one video file, in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from codediffuser.datagen.episode_check import Finding
from codediffuser.datasets import parquet_reader
from codediffuser.datasets.checks.declarations import check_counts, check_features, missing_files
from codediffuser.datasets.checks.duplicates import Duplicates
from codediffuser.datasets.checks.numbers import (
    REMEDY,
    check_clouds,
    check_finite,
    check_motion,
    check_order,
)
from codediffuser.datasets.checks.rows import iterate_episodes, numeric_sizes
from codediffuser.datasets.checks.statistics import check_stats, stats_of
from codediffuser.datasets.checks.videos import check_videos
from codediffuser.datasets.export_meta import (
    DatasetDocument,
    dataset_fingerprint,
    find_document,
    load_info,
    require_features,
)
from codediffuser.datasets.features import ACTION, LABELS, PROGRAM, STATE, depth_key, mask_key
from codediffuser.datasets.stats import Stats
from codediffuser.errors import CodeDiffuserError


def check_dataset(root: Path) -> Iterator[Finding]:
    """Check declarations, files, counts, times, values, pictures, statistics and hashes.

    Yields:
        What is wrong; nothing for a good dataset. Checks stop early when the files cannot be read.

    Raises:
        DatasetError: There is no LeRobot dataset at `root`.
        SchemaVersionError: Its document is of a version that this code cannot read.
    """
    info, document = load_info(root), find_document(root)
    try:
        require_features(root, info, {STATE: "float32", ACTION: "float32"})
        yield from check_features(root, info)
        rows = parquet_reader.read_episode_rows(root)
        yield from check_counts(root, info, rows)
        videos = [key for key, f in info["features"].items() if f["dtype"] == "video"]
        missing = list(missing_files(root, videos, rows))
        yield from missing
        if missing:
            return
        stats: list[dict[str, Stats]] = []
        duplicates, states = Duplicates(), {}
        names = info["features"][ACTION].get("names")
        for episode in iterate_episodes(root, rows, numeric_sizes(info["features"])):
            yield from check_order(episode, info["fps"])
            yield from check_finite(episode)
            yield from check_motion(episode, info["fps"], names)
            yield from check_clouds(episode)
            yield from duplicates.check(episode)
            stats.append(stats_of(episode))
            states[int(episode.meta["episode_index"])] = episode.columns[STATE]
        yield from check_stats(root, stats)
        masked = _is_masked(info, document)
        yield from check_videos(root, videos, rows, info["fps"], states, masked=masked)
    except CodeDiffuserError as error:
        yield Finding("dataset.unreadable", str(root), str(error), REMEDY)
        return
    if document is not None and dataset_fingerprint(root) != document.content_sha256:
        what = "the files are not those that convert wrote"
        yield Finding("dataset.changed", str(root), what, REMEDY)


def _is_masked(info: Mapping[str, Any], document: DatasetDocument | None) -> bool | None:
    """Whether pictures show what is attended alone, the profile `masked-rgb`; None: not told."""
    if document is not None:
        return document.profile == "masked-rgb"
    # Edited by LeRobot's tools. Of labelled episodes, other profiles keep masks beside pictures.
    names = info["features"]
    if any(name.startswith((mask_key(""), depth_key(""))) for name in names):
        return False
    if LABELS in names:
        return True
    # Without labels only our own exports are in doubt: those have programs.
    return None if PROGRAM in names else False
