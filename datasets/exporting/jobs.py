"""Making the parts of an export, in this process or in several, and finding those made before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.workers import run_tasks
from codediffuser.datasets.export_meta import DatasetDocument
from codediffuser.datasets.exporting.choice import Choice
from codediffuser.datasets.exporting.format import ExportFormat
from codediffuser.datasets.exporting.part import Part, code_fingerprint, part_key, seal
from codediffuser.datasets.exporting.source import Source
from codediffuser.errors import CodeDiffuserError, ConfigError, DatasetError
from codediffuser.files import atomic_folder

TIMEOUT_S = 3600.0
"""For one episode; a longer one is taken for hung."""


@dataclass(frozen=True, slots=True)
class PreviousExport:
    """An export at the target whose bytes are those that convert wrote."""

    root: Path
    document: DatasetDocument

    def find(self, key: str) -> int | None:
        """Number of the episode there that was made from a part of this key."""
        for episode in self.document.episodes:
            if episode.part == key:
                return episode.episode_index
        return None


@dataclass(frozen=True, slots=True)
class PartJob:
    """What a worker needs to make one part."""

    part: Part
    format: ExportFormat
    previous: Path | None = None
    index: int = 0
    """The episode's number in the previous export."""


def find_previous(root: Path, format: ExportFormat) -> PreviousExport | None:
    """The export at `root` if it is of this format, and whole; else None.

    A dataset of a newer codediffuser, or one that somebody changed, counts as none.
    """
    if not (root / format.DOCUMENT).is_file():
        return None
    try:
        document = DatasetDocument.load(root / format.DOCUMENT)
        if document.format != format.NAME or document.content_sha256 != format.fingerprint(root):
            return None
    except (ConfigError, DatasetError):
        return None
    return PreviousExport(root, document)


def plan_parts(
    folders: Sequence[Path], format: ExportFormat, kept_in: Path, previous: PreviousExport | None
) -> list[PartJob]:
    """One job per episode, in order.

    Raises:
        DatasetError: An episode lacks a file, or its labels are damaged.
    """
    code = code_fingerprint(format.modules())
    jobs = []
    for folder in folders:
        try:
            Episode.open(folder)
            key = part_key(folder, format.relevant_options, code, labelled=format.labelled)
        except CodeDiffuserError as error:
            raise DatasetError(f"episode {folder.name}: {error}") from error
        part, index = Part(folder, key, kept_in), previous.find(key) if previous else None
        if previous is None or index is None:
            jobs.append(PartJob(part, format))
        else:
            jobs.append(PartJob(part, format, previous.root, index))
    return jobs


def make_parts(jobs: Sequence[PartJob], workers: int) -> Iterator[tuple[str, bool]]:
    """Make what is not there yet; yields each episode's id, and whether nothing was encoded.

    Raises:
        DatasetError: An episode cannot become a part of the export; the message says why.
    """
    if workers <= 1:
        for job in jobs:
            yield job.part.episode_folder.name, ensure_part(job)
        return
    for outcome in run_tasks(ensure_part, jobs, workers=workers, timeout_s=TIMEOUT_S):
        name = outcome.task.part.episode_folder.name
        if outcome.error:
            raise DatasetError(f"episode {name}: {outcome.reason}")
        yield name, bool(outcome.value)


def ensure_part(job: PartJob) -> bool:
    """Make and keep one part unless it is there, or an earlier export holds it.

    Returns:
        Whether it was there.

    Raises:
        DatasetError: The episode cannot become a part; the message says why.
    """
    part = job.part
    if part.is_whole():
        return True
    try:
        with atomic_folder(part.folder) as partial:
            found = job.previous is not None and job.format.recover(
                job.previous, job.index, partial
            )
            if not found:
                job.format.make(
                    Source(
                        part.episode_folder,
                        labelled=job.format.labelled,
                        dilation_px=job.format.options.dilation_px,
                    ),
                    partial,
                )
            seal(partial)
    except CodeDiffuserError as error:
        raise DatasetError(f"episode {part.episode_folder.name}: {error}") from error
    return found


def nothing_changed(
    jobs: Sequence[PartJob], previous: PreviousExport | None, choice: Choice
) -> bool:
    """Whether the previous export already is what would be written."""
    if previous is None:
        return False
    document = previous.document
    return (
        [episode.part for episode in document.episodes] == [job.part.key for job in jobs]
        and document.left_out == tuple(choice.failed)
        and document.rejected == tuple(choice.rejected)
        and document.with_rejected == choice.with_rejected
    )
