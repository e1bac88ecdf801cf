"""`codediffuser convert`: episodes and labels to a dataset that other tools open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from codediffuser.verbs.verb import Verb, console, track


@dataclass(kw_only=True)
class Convert(Verb):
    """Export the successful, labelled episodes of RUN as a dataset, LeRobot v3 by default.

    Episodes that are finished are kept, so a convert that was cut off continues; the dataset itself
    appears whole. What has not changed since the last convert is not encoded again.

    Example: codediffuser convert runs/pack --to lerobot --profile portable --workers 2
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with labelled episodes/."""
    to: Literal["lerobot", "zarr", "robomimic", "aloha", "maniskill", "rosbag2"] = "lerobot"
    """lerobot: LeRobot v3. zarr: replay buffer of diffusion_policy and DP3. robomimic, aloha:
    HDF5 of these projects. maniskill: trajectories of simulated episodes. rosbag2: recordings."""
    out: Path | None = None
    """Folder of the dataset. Default: RUN/lerobot for clouds, else RUN/exports/TO-PROFILE."""
    profile: Literal["pointcloud", "portable", "masked-rgb"] | None = None
    """What a frame holds beside state and action. pointcloud: 512 points with attention. portable:
    colour, depth, masks, calibration. masked-rgb: colour where attention is. Default: pointcloud
    for lerobot and zarr, portable for the others."""
    codec: Literal["av1", "h264", "hevc"] = "av1"
    """Of videos. h264 encodes fastest, av1 is smallest; by default all come as near to the
    pictures."""
    crf: int | None = None
    """Quality of videos: lower is better and larger. Default: 30 for av1, 17 for h264, 21 for
    hevc."""
    workers: int = 1
    """Processes. The same bytes for any number."""
    with_rejected: bool = False
    """Also export episodes whose labels a reviewer rejected."""
    overwrite: bool = False
    """Replace a folder at --out that no convert wrote."""

    def run(self) -> Path:
        """Convert and return the folder of the dataset."""
        from codediffuser.datasets.convert import convert_run
        from codediffuser.datasets.exporting.choice import choose_episodes
        from codediffuser.datasets.exporting.format import format_for
        from codediffuser.datasets.exporting.video import VideoConfig
        from codediffuser.schema import parse_model

        kind, profile = format_for(self.to, self.profile)
        video = parse_model(VideoConfig, {"codec": self.codec, "crf": self.crf}, "--crf")
        choice = choose_episodes(
            self.run_folder,
            needs_labels=profile != "portable",
            with_rejected=self.with_rejected,
        )
        work = convert_run(
            self.run_folder, self.out, to=self.to, profile=profile, video=video,
            workers=self.workers, with_rejected=self.with_rejected, overwrite=self.overwrite,
        )  # fmt: skip
        for _ in track(work, "convert", len(choice.chosen)):
            pass
        console.print(choice.summary, markup=False, soft_wrap=True)
        return self.out or kind.default_out(self.run_folder, profile)
