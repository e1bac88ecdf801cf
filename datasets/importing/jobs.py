"""The plan of an import: which segment of which recording becomes which episode.

The plan depends on the sources and the configuration alone, so ids do not change with the number
of workers, with refusals, or with an import that was cut off.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datasets.importing.array_file import ArrayFile
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.segments import cut_segments
from codediffuser.datasets.importing.sources import open_source
from codediffuser.errors import ConfigError, DatasetError


@dataclass(frozen=True, slots=True)
class Job:
    """One episode to be made."""

    id: str
    source: Path
    segment: int
    """Number within the recording, from 0."""
    episode: str = ""
    """Name within a file of rows; empty for a bag."""
    start_ns: int = 0
    stop_ns: int = 0
    success: bool = True
    scene: Path | None = None
    refusal: str = ""
    """Known before any frame is looked at; empty for none."""

    @property
    def address(self) -> str:
        """`RECORDING#SEGMENT`, as scenes and reports name it."""
        return f"{self.source.name}#{self.segment}"


@dataclass(frozen=True, slots=True)
class _Cut:
    source: Path
    segment: int
    episode: str
    start_ns: int
    stop_ns: int
    success: bool
    refusal: str


def plan_jobs(sources: Sequence[Path], config: ImportConfig, config_folder: Path) -> list[Job]:
    """Cut all sources and give every segment its id and its scene.

    Args:
        sources: Recordings in order.
        config: The configuration.
        config_folder: What the folder of scenes is relative to.

    Raises:
        ConfigError: The folder of scenes is missing or names no scene for an episode.
    """
    cuts = [cut for source in sources for cut in _cuts(source, config)]
    scenes = _scenes(cuts, config, config_folder)
    jobs = []
    for number, (cut, scene) in enumerate(zip(cuts, scenes, strict=True)):
        job_id = f"{config.first_id + number:06d}" if scene is None else _scene_id(scene)
        jobs.append(
            Job(job_id, cut.source, cut.segment, cut.episode, cut.start_ns, cut.stop_ns,
                cut.success, scene, cut.refusal)
        )  # fmt: skip
    _refuse_twins(jobs)
    return jobs


def _cuts(source: Path, config: ImportConfig) -> list[_Cut]:
    """Segments of one source; a source that cannot be opened is one refused segment."""
    try:
        with closing(open_source(source)) as opened:
            if isinstance(opened, ArrayFile):
                return [
                    _Cut(source, i, name, 0, 0, config.success, "")
                    for i, name in enumerate(opened.episodes)
                ]
            segments = cut_segments(opened, config)
            if not segments:
                return [_Cut(source, 0, "", 0, 0, False, "no episode in it")]
            return [
                _Cut(source, i, "", s.start_ns, s.stop_ns, s.success, s.refusal)
                for i, s in enumerate(segments)
            ]
    except DatasetError as error:
        return [_Cut(source, 0, "", 0, 0, False, str(error))]


def _scenes(cuts: Sequence[_Cut], config: ImportConfig, config_folder: Path) -> list[Path | None]:
    if config.scenes is None:
        return [None] * len(cuts)
    folder = config_folder / config.scenes.folder
    files = sorted(folder.glob("*.yaml"))
    if not files:
        raise ConfigError(f"scenes.folder: no scene files (*.yaml) in {folder}")
    if config.scenes.by == "order":
        if len(files) < len(cuts):
            raise ConfigError(
                f"scenes: {len(cuts)} episodes are recorded, {folder} holds {len(files)} scenes; "
                "give a scene for each, or choose them by file"
            )
        return list(files[: len(cuts)])
    chosen: list[Path | None] = []
    for cut in cuts:
        address = f"{cut.source.name}#{cut.segment}"
        name = config.scenes.files.get(address)
        if name is None:
            raise ConfigError(f"scenes.files: no entry for the episode '{address}'")
        chosen.append(folder / name)
    return chosen


def _scene_id(path: Path) -> str:
    return SceneSpec.load(path).scene_id


def _refuse_twins(jobs: Sequence[Job]) -> None:
    seen: dict[str, Job] = {}
    for job in jobs:
        if job.id in seen:
            raise ConfigError(
                f"scenes: the episodes {seen[job.id].address} and {job.address} have the same "
                f"scene {job.id}; an episode is known by its scene"
            )
        seen[job.id] = job
