"""rosbag2: one folder per episode, with the messages of the raw log byte for byte."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets.exporting import rosbag2
from codediffuser.datasets.exporting.format import FORMATS, ExportFormat
from codediffuser.datasets.exporting.part import Part
from codediffuser.datasets.exporting.source import Source

BAG = "bag"


@FORMATS.add("rosbag2")
@dataclass(frozen=True)
class Rosbag2Format(ExportFormat):
    """Recordings that `ros2 bag` and Foxglove open."""

    NAME = "rosbag2"
    PROFILES = ("portable",)

    def modules(self) -> tuple[ModuleType, ...]:
        """The code that decides the bytes of a part."""
        return (rosbag2,)

    def make(self, source: Source, folder: Path) -> None:
        """Write one recording."""
        rosbag2.export_episode(source.episode, folder / BAG)

    def assemble(
        self, root: Path, parts: Sequence[Part], manifests: Sequence[EpisodeManifest]
    ) -> None:
        """Name the recordings after their episodes."""
        for part, manifest in zip(parts, manifests, strict=True):
            shutil.copytree(part.folder / BAG, root / manifest.id)
