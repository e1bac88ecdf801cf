"""LeRobot v3.0, in three profiles."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pyarrow.parquet as pq

from codediffuser import pointcloud, poses
from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets import clouds, episode_clouds, features
from codediffuser.datasets.export_meta import (
    DATA,
    DOCUMENT,
    PART_STATS,
    VIDEO,
    dataset_fingerprint,
    load_info,
)
from codediffuser.datasets.exporting import columns, lerobot_parts, pictures, source, video
from codediffuser.datasets.exporting.columns import PartStats, read_columns, write_columns
from codediffuser.datasets.exporting.format import FORMATS, ExportFormat, same_for_all
from codediffuser.datasets.exporting.lerobot_parts import COLUMNS, STATS, video_file
from codediffuser.datasets.exporting.part import Part
from codediffuser.datasets.exporting.source import Source
from codediffuser.datasets.exporting.video import VideoJoiner
from codediffuser.datasets.features import (
    DEFAULT_FEATURES,
    EPISODE_ID,
    Feature,
    VideoFeature,
    image_key,
    policy_features,
    portable_features,
)
from codediffuser.datasets.lerobot_writer import LeRobotWriter
from codediffuser.datasets.parquet_reader import read_episode_rows
from codediffuser.labeling import attention, attention_2d, motion

ROBOT_TYPE = "panda"


@FORMATS.add("lerobot")
@dataclass(frozen=True)
class LeRobotFormat(ExportFormat):
    """A LeRobot v3.0 dataset."""

    NAME = "lerobot"
    PROFILES = ("pointcloud", "portable", "masked-rgb")
    DOCUMENT = DOCUMENT

    @classmethod
    def default_out(cls, run: Path, profile: str) -> Path:
        """`RUN/lerobot`, where training looks, for clouds."""
        return run / "lerobot" if profile == "pointcloud" else super().default_out(run, profile)

    def fingerprint(self, root: Path) -> str:
        """SHA-256 of the dataset's files, without our own document and card."""
        return dataset_fingerprint(root)

    @property
    def relevant_options(self) -> dict[str, Any]:
        """What of the options decides the bytes of a part."""
        relevant = super().relevant_options
        if self.options.profile != "pointcloud":
            relevant["video"] = self.options.video.model_dump(mode="json")
        return relevant

    def modules(self) -> tuple[ModuleType, ...]:
        """The code that decides the bytes of a part."""
        shared = (columns, features, lerobot_parts, source, poses, attention, motion)
        if self.options.profile == "pointcloud":
            return (*shared, clouds, episode_clouds, pointcloud)
        return (*shared, pictures, video, attention_2d)

    def make(self, source: Source, folder: Path) -> None:
        """Write columns, statistics and videos of one episode."""
        own = self.features(source.manifest)
        if self.options.profile == "pointcloud":
            lerobot_parts.make_pointcloud(source, folder, own, self.options.cloud)
        elif self.options.profile == "portable":
            lerobot_parts.make_portable(source, folder, own, self.options.video, self.labelled)
        else:
            lerobot_parts.make_masked_rgb(source, folder, own, self.options.video)

    def features(self, manifest: EpisodeManifest) -> dict[str, Feature | VideoFeature]:
        """What this profile makes of an episode, without LeRobot's own columns."""
        options, motion_record = self.options, manifest.motion
        if options.profile == "pointcloud":
            cloud = options.cloud.model_dump(mode="json")
            return {**policy_features(options.cloud.num_points, cloud, motion_record)}
        portable = options.profile == "portable"
        seen = [c for c in manifest.cameras if portable or c.calibrated]
        videos = {
            image_key(c.name): VideoFeature(
                c.width, c.height, options.video.info(c.width, c.height, manifest.hz)
            )
            for c in seen
        }
        beside = manifest.cameras if portable else ()
        return {**videos, **portable_features(beside, motion_record, labelled=self.labelled)}

    def assemble(
        self, root: Path, parts: Sequence[Part], manifests: Sequence[EpisodeManifest]
    ) -> None:
        """Join the parts to a dataset."""
        declared = [self.features(manifest) for manifest in manifests]
        shared = same_for_all(manifests, "cameras, state and action", declared)
        writer = LeRobotWriter(
            root,
            shared,
            fps=same_for_all(manifests, "rate in Hz", [m.hz for m in manifests]),
            robot_type=ROBOT_TYPE,
        )
        kept = root / PART_STATS
        kept.mkdir(parents=True)
        for part, manifest in zip(parts, manifests, strict=True):
            writer.add_episode(
                read_columns(part.folder / COLUMNS),
                manifest.instruction,
                PartStats.load(part.folder / STATS),
                {key: part.folder / video_file(key) for key in writer.videos},
            )
            shutil.copyfile(part.folder / STATS, kept / f"{manifest.id}.npz")
        writer.finish()

    def recover(self, previous: Path, index: int, folder: Path) -> bool:
        """Cut one episode out of an earlier export; no picture is decoded."""
        rows = read_episode_rows(previous)
        row, info = rows[index], load_info(previous)
        place = (row["data/chunk_index"], row["data/file_index"])
        earlier = [r for r in rows[:index] if _data_file(r) == place]
        with pq.ParquetFile(
            previous / DATA.format(chunk_index=place[0], file_index=place[1])
        ) as file:
            table = file.read_row_group(len(earlier))
        own = [key for key in table.schema.names if key not in DEFAULT_FEATURES]
        write_columns(table.select(own), folder / COLUMNS)
        for key, feature in info["features"].items():
            if feature["dtype"] == "video":
                _cut_video(previous, row, key, info["fps"], folder / video_file(key))
        episode_id = table[EPISODE_ID][0].as_py()
        shutil.copyfile(previous / PART_STATS / f"{episode_id}.npz", folder / STATS)
        return True


def _data_file(row: dict[str, Any]) -> tuple[int, int]:
    return row["data/chunk_index"], row["data/file_index"]


def _cut_video(previous: Path, row: dict[str, Any], key: str, fps: int, path: Path) -> None:
    joined = previous / VIDEO.format(
        video_key=key,
        chunk_index=row[f"videos/{key}/chunk_index"],
        file_index=row[f"videos/{key}/file_index"],
    )
    joiner = VideoJoiner(path, fps)
    first = round(row[f"videos/{key}/from_timestamp"] * fps)
    joiner.append(joined, first, int(row["length"]))
    joiner.close()
