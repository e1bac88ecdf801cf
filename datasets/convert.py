"""Run to dataset: every successful, labelled episode, the same bytes for any worker count.

Each episode becomes a part, kept in `RUN/.cache/convert` as soon as it is made, so a killed convert
continues where it was. The export itself is written beside its place and renamed, so an export that
exists is whole. Parts that an earlier export holds are taken from there, and an export that would
come out the same is not touched.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.export_meta import DOCUMENT, INFO, OTHER_DOCUMENT, DatasetDocument
from codediffuser.datasets.export_meta import ExportedEpisode as Exported
from codediffuser.datasets.exporting.card import write_card
from codediffuser.datasets.exporting.choice import Choice, choose_episodes
from codediffuser.datasets.exporting.format import (
    ExportFormat,
    ExportOptions,
    format_for,
    same_for_all,
)
from codediffuser.datasets.exporting.jobs import (
    PartJob,
    find_previous,
    make_parts,
    nothing_changed,
    plan_parts,
)
from codediffuser.datasets.exporting.source import labels_sha256
from codediffuser.datasets.exporting.video import VideoConfig
from codediffuser.errors import DatasetError
from codediffuser.files import atomic_folder, remove_partials
from codediffuser.labeling.store import episode_sha256, has_labels, load_labels
from codediffuser.manifest import git_commit, versions


@dataclass(frozen=True, slots=True)
class ConvertProgress:
    """One episode's part is ready."""

    episode_id: str
    done: int
    total: int
    reused: bool
    """Whether it was taken from an interrupted convert or an earlier export."""

    @property
    def note(self) -> str:
        """A few words for a progress bar."""
        return f"{self.episode_id}{' unchanged' if self.reused else ''}"


def convert_run(
    run: Path,
    out: Path | None = None,
    *,
    to: str = "lerobot",
    profile: str | None = None,
    config: CloudConfig | None = None,
    video: VideoConfig | None = None,
    workers: int = 1,
    with_rejected: bool = False,
    overwrite: bool = False,
) -> Iterator[ConvertProgress]:
    """Export a run.

    Args:
        run: Run folder with labelled episodes.
        out: Folder of the export; None for the format's own place in the run.
        to: Format, see `exporting.format.FORMATS`.
        profile: What is exported; None takes the format's default.
        config: Sizes of the clouds; None for the defaults.
        video: Codec and quality; None for the defaults.
        workers: Processes.
        with_rejected: Whether episodes whose labels a reviewer rejected are exported too.
        overwrite: Whether a folder at `out` that no convert wrote may be replaced.

    Yields:
        One item per episode as it gets ready. The export is there when the iterator ends.

    Raises:
        DatasetError: No successful episodes, some without labels, an episode that cannot be
            converted, or something else at `out`. What was at `out` stays.
        NotRegisteredError: No such format.
        ConfigError: The format has no such profile.
    """
    kind, chosen_profile = format_for(to, profile)
    options = ExportOptions(
        profile=chosen_profile, cloud=config or CloudConfig(), video=video or VideoConfig()
    )
    out = out or kind.default_out(run, chosen_profile)
    check_target(out, overwrite)
    choice = choose_episodes(run, needs_labels=options.needs_labels, with_rejected=with_rejected)
    format = kind(options, labelled=any(has_labels(folder) for folder in choice.chosen))
    kept_in = run / ".cache" / "convert"
    with _exclusive(kept_in, run):
        previous = find_previous(out, format)
        jobs = plan_parts(list(choice.chosen), format, kept_in, previous)
        if nothing_changed(jobs, previous, choice):
            shutil.rmtree(kept_in, ignore_errors=True)
            for i, job in enumerate(jobs, start=1):
                yield ConvertProgress(job.part.episode_folder.name, i, len(jobs), True)
            return
        for i, (name, reused) in enumerate(make_parts(jobs, workers), start=1):
            yield ConvertProgress(name, i, len(jobs), reused)
        remove_partials(out.parent)
        with atomic_folder(out) as partial:
            _write_export(partial, run, format, jobs, choice)
        shutil.rmtree(kept_in, ignore_errors=True)


def check_target(out: Path, overwrite: bool) -> None:
    """Raise `DatasetError` when something lies at `out` that no convert wrote."""
    if not out.exists() or overwrite:
        return
    own = any((out / name).exists() for name in (DOCUMENT, OTHER_DOCUMENT))
    if out.is_dir() and (own or not any(out.iterdir())):
        return
    known = " (a LeRobot dataset of another origin)" if (out / INFO).exists() else ""
    raise DatasetError(
        f"{out}: exists and was not written by convert{known}; choose another --out, "
        "or give --overwrite"
    )


def _write_export(
    root: Path,
    run: Path,
    format: ExportFormat,
    jobs: Sequence[PartJob],
    choice: Choice,
) -> None:
    """Join the parts, then describe the result for programs and for people."""
    ordered = [choice.chosen[job.part.episode_folder] for job in jobs]
    same_for_all(ordered, "rate in Hz", [m.hz for m in ordered])
    format.assemble(root, [job.part for job in jobs], ordered)
    document = DatasetDocument(
        format=format.NAME,
        profile=format.options.profile,
        options=format.relevant_options,
        task=",".join(sorted({m.task for m in ordered})),
        cloud=format.options.cloud if format.options.profile == "pointcloud" else None,
        source=run.resolve().name,
        episodes=tuple(_exported(i, job, ordered[i]) for i, job in enumerate(jobs)),
        left_out=tuple(choice.failed),
        rejected=tuple(choice.rejected),
        with_rejected=choice.with_rejected,
        versions=versions(),
        git_commit=git_commit(),
        content_sha256=format.fingerprint(root),
    )
    document.save(root / format.DOCUMENT)
    write_card(root, document, [job.part.episode_folder for job in jobs], format.labelled)


def _exported(index: int, job: PartJob, manifest: EpisodeManifest) -> Exported:
    folder, labelled = job.part.episode_folder, job.format.labelled
    return Exported(
        episode_index=index,
        episode_id=manifest.id,
        frames=manifest.frames,
        episode_sha256=episode_sha256(manifest),
        labels_revision=load_labels(folder).revision if labelled else 0,
        labels_sha256=labels_sha256(folder) if labelled else "",
        part=job.part.key,
    )


@contextlib.contextmanager
def _exclusive(folder: Path, run: Path) -> Iterator[None]:
    """One convert per run at a time; the lock ends with its process, however that ends."""
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder.parent, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DatasetError(f"{run}: another convert of this run is at work; wait for it") from None
    else:
        yield
    finally:
        os.close(descriptor)
