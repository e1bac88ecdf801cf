"""Metadata of a merged dataset: episodes, sentences, statistics, and our own document."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.datasets.export_meta import (
    DOCUMENT,
    EPISODES,
    INFO,
    PART_STATS,
    STATS,
    TASKS,
    DatasetDocument,
    ExportedEpisode,
    dataset_fingerprint,
)
from codediffuser.datasets.exporting.columns import PartStats
from codediffuser.datasets.exporting.pictures import pixel_stats
from codediffuser.datasets.merging.sources import Source, part_stats_file, part_stats_name
from codediffuser.datasets.parquet_reader import iterate, vectors
from codediffuser.datasets.stats import (
    QUANTILES,
    Histogram,
    Stats,
    merge_stats,
    with_quantiles,
)
from codediffuser.files import write_json
from codediffuser.manifest import git_commit, versions

LARGEST_EXACT = 64
"""Columns of more numbers, flat clouds, keep histograms for their quantiles."""

Places = Mapping[tuple[int, tuple[int, int]], tuple[int, int]]
"""Number of the source, and chunk and file there, to chunk and file in the merged dataset."""


def write_meta(
    out: Path, sources: Sequence[Source], tasks: Mapping[str, int], data: Places,
    videos: Mapping[str, Places],
) -> None:  # fmt: skip
    """Write everything under `meta/` of a merged dataset whose files are in place.

    Args:
        out: The merged dataset.
        sources: In their order.
        tasks: Index of each sentence.
        data: Where data files went.
        videos: Where files of each video feature went.
    """
    rows = [r for i, s in enumerate(sources) for r in _rows(i, s, tasks, data, videos)]
    path = out / EPISODES.format(chunk_index=0, file_index=0)
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows), path)
    total = len(rows)
    write_json(
        out / INFO,
        {
            **sources[0].info,
            "total_episodes": total,
            "total_frames": sum(source.num_frames for source in sources),
            "total_tasks": len(tasks),
            "splits": {"train": f"0:{total}"},
        },
    )
    # LeRobot keeps sentences in the index of a pandas frame.
    pd.DataFrame({"task_index": list(tasks.values())}, index=list(tasks)).to_parquet(out / TASKS)
    kept = _keep_part_stats(out, sources)
    stats = _stats(out, rows, kept, sources[0].info["features"])
    write_json(out / STATS, {k: {n: v.tolist() for n, v in s.items()} for k, s in stats.items()})
    if all(source.document for source in sources):
        _document(out, sources).save(out / DOCUMENT)


def _rows(
    number: int, source: Source, tasks: Mapping[str, int], data: Places,
    videos: Mapping[str, Places],
) -> list[dict[str, Any]]:  # fmt: skip
    def moved(row: dict[str, Any], prefix: str, places: Places) -> dict[str, int]:
        at = (int(row[f"{prefix}/chunk_index"]), int(row[f"{prefix}/file_index"]))
        chunk, file = places[number, at]
        return {f"{prefix}/chunk_index": chunk, f"{prefix}/file_index": file}

    found = []
    for position, row in enumerate(source.rows):
        new = {
            **row,
            "episode_index": source.first_episode + position,
            "dataset_from_index": int(row["dataset_from_index"]) + source.first_frame,
            "dataset_to_index": int(row["dataset_to_index"]) + source.first_frame,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            **moved(row, "data", data),
            **_shifted(row, "index", source.first_frame),
            **_shifted(row, "episode_index", source.first_episode),
            **_shifted(row, "task_index", tasks[row["tasks"][0]] - _only(row, "task_index")),
        }
        for key, places in videos.items():
            new |= moved(row, f"videos/{key}", places)
        found.append(new)
    return found


def _shifted(row: Mapping[str, Any], key: str, by: int) -> dict[str, list[float]]:
    """Statistics of a column of numbers when all of them grow by the same."""
    moving = ("min", "max", "mean", *QUANTILES)
    names = [f"stats/{key}/{name}" for name in moving if f"stats/{key}/{name}" in row]
    return {name: [value + by for value in row[name]] for name in names}


def _only(row: Mapping[str, Any], key: str) -> int:
    """The number that a column has throughout an episode; 0 when nothing is known of it."""
    return int(row.get(f"stats/{key}/min", [0])[0])


def _keep_part_stats(out: Path, sources: Sequence[Source]) -> list[Path] | None:
    """Copy the exact statistics of every episode; None when some are not there."""
    if not all(source.document for source in sources):
        return None
    named = [(s.root, e) for s in sources if s.document for e in s.document.episodes]
    counted = Counter(episode.episode_id for _, episode in named)
    found = []
    for root, episode in named:
        path = part_stats_file(root, episode)
        if not path.exists():
            return None
        name = part_stats_name(episode, by_content=counted[episode.episode_id] > 1)
        found.append((path, out / PART_STATS / name))
    (out / PART_STATS).mkdir(parents=True)
    return [Path(shutil.copyfile(path, target)) for path, target in found]


def _stats(
    out: Path, rows: Sequence[dict[str, Any]], kept: Sequence[Path] | None,
    features: Mapping[str, Any],
) -> dict[str, Stats]:  # fmt: skip
    """Statistics of all frames. Quantiles are exact but for features of which too little is kept.

    Those are joined as LeRobot does it: the mean of the episodes' quantiles.
    """
    keys = sorted({name.split("/")[1] for name in rows[0] if name.startswith("stats/")})
    merged = {key: merge_stats([_of_row(row, key) for row in rows]) for key in keys}
    exact: dict[str, np.ndarray] = {}
    apart: set[str] = set()
    if kept is not None:
        parts = [PartStats.load(path) for path in kept]
        apart = set().union(*({*p.stats, *p.pixel_counts} for p in parts))
        for key in apart & merged.keys():
            if all(key in part.histograms for part in parts):
                channels = zip(*(part.histograms[key] for part in parts), strict=True)
                exact[key] = np.stack([Histogram.sum(c).quantiles() for c in channels], axis=1)
            elif all(key in part.pixel_counts for part in parts):
                counts = np.sum([part.pixel_counts[key] for part in parts], axis=0)
                merged[key] = pixel_stats(counts, sum(int(row["length"]) for row in rows))
    numeric = {
        key: int(np.prod(features[key]["shape"]))
        for key in merged
        if key not in apart and features[key]["dtype"] not in ("video", "image", "string")
    }
    small = {key: size for key, size in numeric.items() if size <= LARGEST_EXACT}
    exact |= _column_quantiles(out, small)
    return {k: with_quantiles(s, exact[k]) if k in exact else s for k, s in merged.items()}


def _column_quantiles(out: Path, sizes: Mapping[str, int]) -> dict[str, np.ndarray]:
    values: dict[str, list[np.ndarray]] = {key: [] for key in sizes}
    for batch in iterate(out, list(sizes)):
        for i, (key, size) in enumerate(sizes.items()):
            values[key].append(vectors(batch.column(i), size, f"{out}: {key}"))
    return {
        key: np.quantile(np.concatenate(v).astype(np.float64), list(QUANTILES.values()), axis=0)
        for key, v in values.items()
    }


def _of_row(row: Mapping[str, Any], key: str) -> Stats:
    prefix = f"stats/{key}/"
    return {n.removeprefix(prefix): np.array(v) for n, v in row.items() if n.startswith(prefix)}


def _document(out: Path, sources: Sequence[Source]) -> DatasetDocument:
    documents = [source.document for source in sources if source.document]
    episodes: list[ExportedEpisode] = []
    for document in documents:
        for episode in sorted(document.episodes, key=lambda e: e.episode_index):
            episodes.append(episode.model_copy(update={"episode_index": len(episodes)}))
    tasks = dict.fromkeys(t for d in documents for t in d.task.split(","))
    return documents[0].model_copy(
        update={
            "task": ",".join(tasks),
            "source": ", ".join(document.source for document in documents),
            "episodes": tuple(episodes),
            "left_out": tuple(name for document in documents for name in document.left_out),
            "rejected": tuple(name for document in documents for name in document.rejected),
            "versions": versions(),
            "git_commit": git_commit(),
            "content_sha256": dataset_fingerprint(out),
        }
    )
