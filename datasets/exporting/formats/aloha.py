"""ALOHA HDF5: one `episode_<i>.hdf5` with `action`, `observations/{qpos, qvel, images/<camera>}`.

Layout: tonyzhaozh/aloha, `record_episodes.py`. `action` is this project's: ten numbers of a hand
pose where ALOHA has fourteen joint targets; the file's attributes name them.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets.exporting import h5_parts, pictures, source
from codediffuser.datasets.exporting.format import FORMATS, ExportFormat
from codediffuser.datasets.exporting.h5_parts import (
    PART,
    PicturePaths,
    joint_states,
    open_part,
    put,
    write_pictures,
)
from codediffuser.datasets.exporting.part import Part
from codediffuser.datasets.exporting.source import Source, labels_json
from codediffuser.labeling import attention, attention_2d, motion

PATHS = PicturePaths(
    rgb="observations/images/{camera}",
    depth="observations/depth/{camera}",
    mask="observations/attention/{camera}",
)


@FORMATS.add("aloha")
@dataclass(frozen=True)
class AlohaFormat(ExportFormat):
    """One HDF5 file per episode, as ACT's loader reads them."""

    NAME = "aloha"
    PROFILES = ("portable", "masked-rgb")

    def modules(self) -> tuple[ModuleType, ...]:
        """The code that decides the bytes of a part."""
        return (h5_parts, pictures, source, attention, attention_2d, motion)

    def make(self, source: Source, folder: Path) -> None:
        """Write one episode."""
        episode, manifest = source.episode, source.manifest
        names, qpos, qvel = joint_states(episode)
        with open_part(folder, "w") as file:
            file["action"] = episode.actions
            put(file, "observations/qpos", qpos.astype(np.float32))
            put(file, "observations/qvel", qvel.astype(np.float32))
            put(file, "observations/state", episode.state)
            write_pictures(file, source, self.options, PATHS, self.labelled)
            file.attrs["sim"] = manifest.source == "simulation"
            file.attrs["compress"] = False
            file.attrs["hz"] = manifest.hz
            file.attrs["episode_id"] = manifest.id
            file.attrs["instruction"] = manifest.instruction
            file.attrs["joint_names"] = json.dumps(names)
            file.attrs["action_names"] = json.dumps(manifest.motion.action_names)
            file.attrs["state_names"] = json.dumps(manifest.motion.state_names)
            if self.labelled:
                file.attrs["labels"] = labels_json(source.folder)

    def assemble(
        self, root: Path, parts: Sequence[Part], manifests: Sequence[EpisodeManifest]
    ) -> None:
        """Number the files."""
        for i, part in enumerate(parts):
            shutil.copyfile(part.folder / PART, root / f"episode_{i}.hdf5")

    def recover(self, previous: Path, index: int, folder: Path) -> bool:
        """Take one file."""
        shutil.copyfile(previous / f"episode_{index}.hdf5", folder / PART)
        return True
