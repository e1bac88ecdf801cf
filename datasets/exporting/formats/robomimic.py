"""robomimic HDF5: `demo.hdf5` with `data/demo_<i>/{actions, dones, rewards, obs/...}`.

Layout: robomimic documentation, "Dataset contents". `next_obs` is left out, as by robomimic's own
`--exclude-next-obs`; load with `hdf5_load_next_obs=False`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets import clouds, episode_clouds
from codediffuser.datasets.exporting import h5_parts, pictures, source
from codediffuser.datasets.exporting.format import FORMATS, ExportFormat
from codediffuser.datasets.exporting.h5_parts import (
    PicturePaths,
    copy_group,
    joint_states,
    open_part,
    put,
    write_cloud,
    write_pictures,
)
from codediffuser.datasets.exporting.part import Part
from codediffuser.datasets.exporting.source import Source, labels_json
from codediffuser.datasets.splits import split_episodes
from codediffuser.labeling import attention, attention_2d, motion

FILE = "demo.hdf5"
PATHS = PicturePaths(
    rgb="obs/{camera}_image",
    depth="obs/{camera}_depth",
    mask="obs/{camera}_attention",
    channel_axis=True,
)


@FORMATS.add("robomimic")
@dataclass(frozen=True)
class RobomimicFormat(ExportFormat):
    """One HDF5 file that robomimic's `SequenceDataset` reads."""

    NAME = "robomimic"
    PROFILES = ("portable", "pointcloud", "masked-rgb")

    def modules(self) -> tuple[ModuleType, ...]:
        """The code that decides the bytes of a part."""
        return (h5_parts, pictures, source, clouds, episode_clouds, attention, attention_2d, motion)

    def make(self, source: Source, folder: Path) -> None:
        """Write one demonstration."""
        episode, manifest = source.episode, source.manifest
        length = episode.num_frames
        with open_part(folder, "w") as file:
            file["actions"] = episode.actions
            put(file, "obs/state", episode.state)
            put(file, "obs/joint_positions", joint_states(episode)[1].astype(np.float32))
            # Sparse: what is exported succeeded, and does so at its end.
            last = np.arange(length) == length - 1
            file["rewards"] = last.astype(np.float64)
            file["dones"] = last.astype(np.int64)
            if self.options.profile == "pointcloud":
                write_cloud(file, "obs/point_cloud", source, self.options.cloud)
            else:
                write_pictures(file, source, self.options, PATHS, self.labelled)
            file.attrs["num_samples"] = length
            file.attrs["episode_id"] = manifest.id
            file.attrs["language_instruction"] = manifest.instruction
            if self.labelled:
                file.attrs["labels"] = labels_json(source.folder)

    def assemble(
        self, root: Path, parts: Sequence[Part], manifests: Sequence[EpisodeManifest]
    ) -> None:
        """Copy the demonstrations into one file and name the splits."""
        import h5py

        with h5py.File(root / FILE, "w") as file:
            data = file.create_group("data")
            for i, part in enumerate(parts):
                with open_part(part.folder) as made:
                    copy_group(made, data.create_group(f"demo_{i}"))
            data.attrs["total"] = sum(m.frames for m in manifests)
            data.attrs["env_args"] = json.dumps(
                {
                    "env_name": manifests[0].task,
                    "type": 1,
                    "env_kwargs": {"control_freq": manifests[0].hz},
                }
            )
            split = split_episodes([m.id for m in manifests])
            for name, members in zip(("train", "valid"), split, strict=True):
                names = np.array([f"demo_{i}" for i in members], dtype="S")
                file.create_dataset(f"mask/{name}", data=names)

    def recover(self, previous: Path, index: int, folder: Path) -> bool:
        """Copy one demonstration out of an earlier file."""
        import h5py

        with h5py.File(previous / FILE, "r") as file, open_part(folder, "w") as part:
            copy_group(file["data"][f"demo_{index}"], part)
        return True
