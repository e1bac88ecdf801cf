"""`codediffuser import`: recordings that others made become episodes of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from codediffuser.errors import BelowTargetError, ConfigError
from codediffuser.verbs.verb import Verb, console, print_table, track

if TYPE_CHECKING:
    from codediffuser.datasets.importing.run import ImportResult
    from codediffuser.datasets.importing.survey import Survey


@dataclass(kw_only=True)
class Import(Verb):
    """Import bags (MCAP, rosbag2, ROS 1), HDF5 (ALOHA, robomimic, ManiSkill) or zarr into a run.

    First with --inspect, which writes an import.yaml to look through. Running again continues.

    Example: codediffuser import bags/ --config import.yaml --out runs/real
    """

    source: tyro.conf.Positional[Path]
    """A recording, or a folder of several."""
    config: Path = Path("import.yaml")
    """What is where in the recording. With --inspect it is written."""
    out: Path | None = None
    """Run folder."""
    inspect: bool = False
    """Only look: print topics, types, rates, gaps, and write a first --config."""
    task: str = "pack_battery"
    """With --inspect: the task that the first --config names."""
    workers: int = 1
    """Processes. Changes nothing but the time."""
    overwrite: bool = False
    """Make episodes again that are there, and their labels go; with --inspect replace --config."""
    min_success: float = 0.0
    """Exit with code 3 when less than this share of the recorded episodes is imported."""

    def run(self) -> Path:
        """Import and return the run folder, or inspect and return the configuration."""
        if self.inspect:
            return self._inspect()
        if self.out is None:
            raise ConfigError("import: give --out RUN, or --inspect to only look")
        if not self.config.is_file():
            raise ConfigError(
                f"{self.config}: no such file; `codediffuser import {self.source} --inspect` "
                "writes a first one"
            )
        from codediffuser.datasets.importing.config import ImportConfig
        from codediffuser.datasets.importing.run import import_recordings

        work = import_recordings(
            self.source, ImportConfig.load(self.config), self.out,
            config_folder=self.config.parent, workers=self.workers, overwrite=self.overwrite,
        )  # fmt: skip
        results = list(track(work, "import", None))
        _tell(results)
        refused = sum(r.outcome == "refused" for r in results)
        share = 1 - refused / max(len(results), 1)
        if share < self.min_success or refused == len(results):
            raise BelowTargetError(
                f"{len(results) - refused} of {len(results)} recorded episodes are imported; the "
                f"reasons stand in {self.out / 'import.json'}"
            )
        return self.out

    def _inspect(self) -> Path:
        from codediffuser.datasets.importing.first_config import write_first_config
        from codediffuser.datasets.importing.sources import find_sources
        from codediffuser.datasets.importing.survey import survey_source

        sources = find_sources(self.source)
        survey = survey_source(sources[0])
        if len(sources) > 1:
            console.print(f"{len(sources)} recordings; this is the first of them")
        _show(survey)
        if self.config.exists() and not self.overwrite:
            raise ConfigError(
                f"{self.config} is there already and was not touched; give --overwrite, or "
                "another --config"
            )
        return write_first_config(survey, self.config, self.task)


def _show(survey: Survey) -> None:
    """Print a table of topics."""
    from rich.table import Table

    length = f"{survey.seconds:.1f} s" if survey.seconds else f"{survey.episodes} episodes"
    console.print(f"{survey.path.name}: {survey.format}, {length}", markup=False)
    table = Table(box=None, pad_edge=False)
    # A narrow terminal folds names and keeps numbers whole.
    table.add_column("topic", overflow="fold")
    table.add_column("type", overflow="fold")
    table.add_column("role", no_wrap=True)
    for name in ("count", "Hz", "gaps", "longest"):
        table.add_column(name, justify="right", no_wrap=True)
    for topic in survey.topics:
        rate = f"{topic.rate_hz:.1f}" if topic.rate_hz else ""
        longest = f"{topic.longest_gap_s:.2f} s" if topic.gaps else ""
        table.add_row(
            topic.name, topic.type, topic.role, str(topic.count), rate, str(topic.gaps or ""),
            longest,
        )  # fmt: skip
    print_table(table)
    for text in survey.damage:
        console.print(f"damaged: {text}", markup=False)


def _tell(results: list[ImportResult]) -> None:
    """Print counts, and why episodes were refused."""
    made = [r for r in results if r.outcome == "imported"]
    kept = sum(r.outcome == "kept" for r in results)
    refused = [r for r in results if r.outcome == "refused"]
    console.print(
        f"{len(made)} episodes imported with {sum(r.frames for r in made)} frames, {kept} were "
        f"there, {len(refused)} refused"
    )
    for result in refused:
        console.print(f"  {result.job.address}: {result.reason}", markup=False, soft_wrap=True)
