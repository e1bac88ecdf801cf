"""`codediffuser demo`: scripted demonstrations of a run's scenes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from codediffuser.errors import BelowTargetError, ConfigError
from codediffuser.verbs.verb import Verb, console, track

if TYPE_CHECKING:
    from codediffuser.datagen.collect import CollectOptions
    from codediffuser.datagen.demo_results import DemoResult
    from codediffuser.datagen.pictures import PictureOptions
    from codediffuser.datagen.shards.drive import Executor


@dataclass(kw_only=True)
class Demo(Verb):
    """Demonstrate every scene of RUN/scenes in the simulator, into RUN/episodes.

    Physics first, pictures second, from the stored states. Running again continues; a scene that
    the expert failed is counted with its reason and not tried again unless --overwrite.

    Examples:
      codediffuser demo runs/pack --workers 2 --size 160x120
      codediffuser demo runs/pack --randomize strong --recovery 0.3
      codediffuser demo runs/pack --rerender --size 640x480
      codediffuser demo runs/pack --executor ray --workers 8
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with scenes/."""
    workers: int = 1
    """Processes. Changes nothing but the time."""
    size: Literal["160x120", "320x240", "480x360", "640x480", "task"] = "task"
    """Width and height of the pictures; `task` takes those of the task's YAML."""
    image_format: Literal["jpeg", "png"] = "jpeg"
    """Compression of the colour pictures. Depth is always lossless."""
    randomize: str | None = None
    """Preset (mild, strong) or YAML file of domain randomisation; `off` takes it away again when
    rerendering. Left out: the usual look, or when rerendering the one that each episode has."""
    recovery: float = 0.0
    """Share of the demonstrations whose hand is pushed once and makes it good."""
    physics_only: bool = False
    """Only find out which scenes the expert solves; a later call draws their pictures."""
    rerender: bool = False
    """Only make the pictures again, from the stored states of episodes that are there."""
    overwrite: bool = False
    """Make whole episodes again and try failures again."""
    timeout_s: float = 600.0
    """A scene that takes longer hangs: its process is replaced, after two tries it is a failure."""
    recycle: int = 100
    """Scenes after which a process is replaced by a fresh one; 0 for never."""
    executor: Literal["processes", "local", "ray", "slurm"] = "processes"
    """Where it runs. `processes`: scene by scene on this machine. The others work off a shard plan
    in RUN/shards, which any number of machines may share."""
    shard_size: int = 20
    """Scenes of a shard."""
    ray_address: str | None = None
    """Of a Ray cluster; left out, RAY_ADDRESS, or one that is started on this machine."""
    slurm_partition: str | None = None
    """Slurm's default when left out."""
    slurm_minutes: int = 120
    """Time limit of a job, which records one shard."""
    slurm_memory_gb: float = 8.0
    """Memory of a job."""
    slurm_cluster: Literal["slurm", "local", "debug"] = "slurm"
    """`local` runs the jobs as processes of this machine, to try things without Slurm."""
    min_success: float = 0.0
    """Exit with code 3 when fewer than this share of the scenes succeeded."""

    def run(self) -> Path:
        """Collect and return the folder of episodes, or of states."""
        from codediffuser.datagen.collect import scene_ids, simulated_episodes
        from codediffuser.datagen.episode_format import EPISODES
        from codediffuser.datagen.physics_store import PHYSICS

        self._check_options()
        options = self._options()
        if self.rerender:
            total, what = len(simulated_episodes(self.run_folder)), "rerender"
        else:
            total, what = len(scene_ids(self.run_folder)), "demo"
        for _ in track(self._results(options), what, total):
            pass
        if not self.rerender:
            self._report()
        return self.run_folder / (PHYSICS if self.physics_only else EPISODES)

    def _results(self, options: CollectOptions) -> Iterator[DemoResult]:
        from codediffuser.datagen.collect import collect_demos, rerender
        from codediffuser.datagen.shards.drive import collect_shards

        if self.rerender:
            return rerender(self.run_folder, options, workers=self.workers)
        if self.executor == "processes":
            return collect_demos(self.run_folder, options, workers=self.workers)
        return collect_shards(
            self.run_folder, self._executor(), options, shard_size=self.shard_size
        )

    def _check_options(self) -> None:
        if self.rerender and (self.physics_only or self.executor != "processes"):
            raise ConfigError(
                "--rerender draws pictures in processes of this machine; leave out --physics-only "
                "and --executor"
            )
        if self.randomize == "off" and not self.rerender:
            raise ConfigError("--randomize off is for --rerender; new episodes have the usual look")
        if not 0 <= self.recovery <= 1:
            raise ConfigError(f"--recovery: expected a share from 0 to 1, got {self.recovery}")
        if self.workers < 1 or self.recycle < 0 or self.timeout_s <= 0:
            raise ConfigError(
                "expected --workers of at least 1, --recycle of at least 0 and --timeout-s above "
                f"0, got {self.workers}, {self.recycle} and {self.timeout_s}"
            )

    def _options(self) -> CollectOptions:
        from codediffuser.datagen.collect import CollectOptions

        return CollectOptions(
            pictures=self._pictures(),
            recovery=self.recovery,
            physics_only=self.physics_only,
            overwrite=self.overwrite,
            timeout_s=self.timeout_s,
            recycle_after=self.recycle,
        )

    def _pictures(self) -> PictureOptions:
        from codediffuser.datagen.episode_format import ImageOptions
        from codediffuser.datagen.pictures import NamedRanges, PictureOptions
        from codediffuser.datagen.randomization import load_randomization

        width, height = (None, None) if self.size == "task" else map(int, self.size.split("x"))
        looks: NamedRanges | Literal["stored", "usual"] = "stored"
        if self.randomize == "off":
            looks = "usual"
        elif self.randomize is not None:
            looks = NamedRanges(
                name=Path(self.randomize).name, ranges=load_randomization(self.randomize)
            )
        image = ImageOptions(format=self.image_format)
        return PictureOptions(width=width, height=height, image=image, looks=looks)

    def _executor(self) -> Executor:
        if self.executor == "ray":
            from codediffuser.datagen.executors.ray import RayExecutor

            return RayExecutor(self.workers, self.ray_address)
        if self.executor == "slurm":
            from codediffuser.datagen.executors.slurm import SlurmExecutor, SlurmOptions

            wanted = SlurmOptions(
                self.slurm_partition, self.slurm_minutes, self.slurm_memory_gb, self.slurm_cluster
            )
            return SlurmExecutor(self.run_folder / "shards" / "slurm", self.workers, wanted)
        from codediffuser.datagen.executors.local import LocalExecutor

        return LocalExecutor(self.workers)

    def _report(self) -> None:
        from codediffuser.datagen.demo_results import SUMMARY, DemoSummary, report_lines

        summary = DemoSummary.load(self.run_folder / SUMMARY)
        for line in report_lines(summary):
            console.print(line)
        if summary.success_rate < self.min_success:
            raise BelowTargetError(
                f"{summary.successes} of {summary.scenes} scenes succeeded, below the "
                f"--min-success of {self.min_success}; see {self.run_folder / SUMMARY}"
            )
