"""Does `info.json` say what the files hold? Shapes, counts, and files that episodes name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from codediffuser.datagen.episode_check import Finding
from codediffuser.datasets.checks.numbers import REMEDY
from codediffuser.datasets.export_meta import DATA, INFO, VIDEO
from codediffuser.datasets.features import ACTION, POINT_CHANNELS, POINTS, STATE


def check_features(root: Path, info: dict[str, Any]) -> Iterator[Finding]:
    """Shapes and names of the columns that policies read."""
    where, features = str(root / INFO), info["features"]
    if POINTS in features:
        size = int(features[POINTS]["shape"][0])
        if size == 0 or size % len(POINT_CHANNELS):
            what = f"{POINTS} has {size} numbers, not {len(POINT_CHANNELS)} for each point"
            yield Finding("dataset.shape", where, what, REMEDY)
    for key in (STATE, ACTION):
        shape, names = list(features[key]["shape"]), features[key].get("names")
        if isinstance(names, list) and shape != [len(names)]:
            what = f"{key}: expected shape [{len(names)}] as it has names, found {shape}"
            yield Finding("dataset.shape", where, what, REMEDY)


def check_counts(
    root: Path, info: dict[str, Any], rows: Sequence[dict[str, Any]]
) -> Iterator[Finding]:
    """Totals are those of the episodes, which follow one another without a gap."""
    tasks = len({task for row in rows for task in row["tasks"]})
    for key, found in (
        ("total_episodes", len(rows)),
        ("total_frames", sum(int(row["length"]) for row in rows)),
        ("total_tasks", tasks),
    ):
        if info.get(key) != found:
            what = f"{key} is {info.get(key)}, the episodes have {found}"
            yield Finding("dataset.counts", str(root / INFO), what, REMEDY)
    first = 0
    for row in rows:
        if int(row["dataset_from_index"]) != first:
            what = (
                f"episode {row['episode_index']} begins at frame {row['dataset_from_index']}, "
                f"expected {first}"
            )
            yield Finding("dataset.episodes-gap", str(root / "meta/episodes"), what, REMEDY)
            return
        first += int(row["length"])


def missing_files(
    root: Path, videos: Sequence[str], rows: Sequence[dict[str, Any]]
) -> Iterator[Finding]:
    """Files that the episodes name and that are not there."""
    named = {
        root / DATA.format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        for row in rows
    }
    for key in videos:
        named |= {
            root
            / VIDEO.format(
                video_key=key,
                chunk_index=row[f"videos/{key}/chunk_index"],
                file_index=row[f"videos/{key}/file_index"],
            )
            for row in rows
        }
    for path in sorted(named):
        if not path.is_file():
            what = "no such file, though meta/episodes names it"
            yield Finding("dataset.file-missing", str(path), what, REMEDY)
