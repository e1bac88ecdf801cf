"""What is merged: datasets that declare the same, each with its place in the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.datasets.export_meta import (
    DATA,
    INFO,
    PART_STATS,
    TASKS,
    VIDEO,
    DatasetDocument,
    ExportedEpisode,
    find_document,
    load_info,
)
from codediffuser.datasets.parquet_reader import read_episode_rows
from codediffuser.errors import DatasetError

MUST_AGREE = ("fps", "robot_type", "features")


@dataclass(frozen=True, slots=True)
class Source:
    """One dataset, and where it begins in the merged one."""

    root: Path
    info: dict[str, Any]
    rows: list[dict[str, Any]]
    """Of `meta/episodes`, in order."""
    tasks: dict[int, str]
    """Sentence of each task index."""
    document: DatasetDocument | None
    """Ours; None for a dataset that LeRobot's tools edited."""
    first_episode: int
    first_frame: int

    @property
    def videos(self) -> tuple[str, ...]:
        """Names of the video features."""
        return tuple(k for k, f in self.info["features"].items() if f["dtype"] == "video")

    @property
    def num_frames(self) -> int:
        """Frames of all episodes."""
        return sum(int(row["length"]) for row in self.rows)

    def data_files(self) -> list[tuple[int, int]]:
        """Chunk and number of each data file, in the order of its frames."""
        return _in_order(self.rows, "data/chunk_index", "data/file_index")

    def video_files(self, key: str) -> list[tuple[int, int]]:
        """Chunk and number of each file of a video feature, in the order of its episodes."""
        return _in_order(self.rows, f"videos/{key}/chunk_index", f"videos/{key}/file_index")

    def data_path(self, place: tuple[int, int]) -> Path:
        """Path of a data file."""
        return self.root / DATA.format(chunk_index=place[0], file_index=place[1])

    def video_path(self, key: str, place: tuple[int, int]) -> Path:
        """Path of a video file."""
        return self.root / VIDEO.format(video_key=key, chunk_index=place[0], file_index=place[1])


def open_sources(roots: Sequence[Path]) -> list[Source]:
    """Read what merging needs of each dataset, and check that they can be joined.

    Raises:
        DatasetError: Fewer than two datasets, one of them damaged or empty, two that declare
            different things, or the same episode twice; the message names what differs and where.
    """
    if len(roots) < 2:
        raise DatasetError(f"merge: expected at least two datasets, got {len(roots)}")
    sources: list[Source] = []
    episodes = frames = 0
    for root in roots:
        source = Source(
            root=root,
            info=load_info(root),
            rows=read_episode_rows(root),
            tasks=_read_tasks(root),
            document=find_document(root),
            first_episode=episodes,
            first_frame=frames,
        )
        if not source.rows:
            raise DatasetError(f"{root}: holds no episodes; leave it out")
        _check_agree(sources[0] if sources else source, source)
        _check_files(source)
        sources.append(source)
        episodes, frames = episodes + len(source.rows), frames + source.num_frames
    _check_no_episode_twice(sources)
    return sources


def part_stats_file(root: Path, episode: ExportedEpisode) -> Path:
    """Where the exact statistics of an episode lie, see `PartStats`.

    Ids of episodes are unique in a run but not across runs, so a merged dataset may name the file
    by content as well.
    """
    by_content = root / PART_STATS / part_stats_name(episode, by_content=True)
    return by_content if by_content.exists() else root / PART_STATS / part_stats_name(episode)


def part_stats_name(episode: ExportedEpisode, *, by_content: bool = False) -> str:
    """Name of that file."""
    return f"{episode.episode_id}{f'-{episode.episode_sha256[:12]}' if by_content else ''}.npz"


def _in_order(rows: list[dict[str, Any]], chunk: str, file: str) -> list[tuple[int, int]]:
    return list(dict.fromkeys((int(row[chunk]), int(row[file])) for row in rows))


def _read_tasks(root: Path) -> dict[int, str]:
    path = root / TASKS
    try:
        table = pq.read_table(path).to_pandas()
    except (pa.ArrowException, OSError) as error:
        raise DatasetError(f"{path}: not readable: {error}") from None
    return {int(index): str(text) for text, index in table["task_index"].items()}


def _check_agree(first: Source, other: Source) -> None:
    for key in MUST_AGREE:
        mine, its = first.info.get(key), other.info.get(key)
        if mine == its:
            continue
        what = f"{key} is {its!r}, in {first.root} it is {mine!r}"
        if key == "features":
            assert isinstance(mine, dict) and isinstance(its, dict)
            names = sorted(n for n in mine.keys() | its.keys() if mine.get(n) != its.get(n))
            what = f"these features differ from those in {first.root}: {', '.join(names)}"
            if told := _first_difference(mine.get(names[0]), its.get(names[0])):
                what += f" ({told})"
        raise DatasetError(
            f"{other.root / INFO}: {what}; only datasets that declare the same can be merged: "
            "convert the runs again with the same profile and options"
        )


def _first_difference(mine: Any, its: Any, path: str = "") -> str:
    """Where two declarations of one feature part; empty where one of them has none."""
    if mine is None or its is None:
        return ""
    if isinstance(mine, dict) and isinstance(its, dict):
        key = min(k for k in mine.keys() | its.keys() if mine.get(k) != its.get(k))
        return _first_difference(mine.get(key), its.get(key), f"{path}{key} ")
    return f"{path}is {its!r}, there it is {mine!r}"


def _check_files(source: Source) -> None:
    """Every file that the episodes name is there."""
    named = [source.data_path(place) for place in source.data_files()]
    for key in source.videos:
        named += [source.video_path(key, place) for place in source.video_files(key)]
    for path in named:
        if not path.is_file():
            raise DatasetError(
                f"{path}: no such file, though meta/episodes names it; run `codediffuser validate "
                f"{source.root}`"
            )


def _check_no_episode_twice(sources: Sequence[Source]) -> None:
    seen: dict[str, tuple[str, Path]] = {}
    for source in sources:
        for episode in source.document.episodes if source.document else ():
            if episode.episode_sha256 in seen:
                name, root = seen[episode.episode_sha256]
                raise DatasetError(
                    f"{source.root}: episode {episode.episode_id} is episode {name} of {root} over "
                    "again; an episode counts once: leave one of the datasets out, or delete it "
                    "there with lerobot-edit-dataset"
                )
            seen[episode.episode_sha256] = (episode.episode_id, source.root)
