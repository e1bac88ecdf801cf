"""Run to LeRobot dataset: every successful, labelled episode, the same bytes for any worker count.

Clouds are the slow part. Each episode's are kept in `RUN/.cache/convert` as soon as they are made,
so a killed convert continues where it was; the dataset itself is written beside its place and
renamed, so a dataset that exists is whole.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from codediffuser.datagen.episode import list_episodes, load_manifest
from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datagen.workers import run_tasks
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.episode_clouds import (
    CloudJob,
    EpisodeColumns,
    code_fingerprint,
    ensure_columns,
    labels_json,
    load_columns,
)
from codediffuser.datasets.export_meta import (
    DOCUMENT,
    INFO,
    DatasetDocument,
    ExportedEpisode,
    dataset_fingerprint,
)
from codediffuser.datasets.features import (
    ACTION,
    EPISODE_ID,
    LABELS,
    POINT_CHANNELS,
    POINTS,
    STATE,
    policy_features,
)
from codediffuser.datasets.lerobot_writer import LeRobotWriter
from codediffuser.datasets.stats import feature_stats
from codediffuser.errors import ConfigError, DatasetError
from codediffuser.files import atomic_folder, remove_partials, sha256_file
from codediffuser.labeling.store import LABELS as LABELS_FILE
from codediffuser.labeling.store import episode_sha256, has_labels, load_labels
from codediffuser.manifest import git_commit, versions
from codediffuser.registry import unknown_name

PROFILES = ("pointcloud",)
ROBOT_TYPE = "panda"


@dataclass(frozen=True, slots=True)
class ConvertProgress:
    """One episode's clouds are ready."""

    episode_id: str
    done: int
    total: int
    reused: bool
    """Whether an earlier, interrupted convert had made them."""


def convert_run(
    run: Path,
    out: Path | None = None,
    *,
    profile: str = "pointcloud",
    config: CloudConfig | None = None,
    workers: int = 1,
    overwrite: bool = False,
) -> Iterator[ConvertProgress]:
    """Export a run as a LeRobot v3.0 dataset.

    Args:
        run: Run folder with labelled episodes.
        out: Folder of the dataset; None for `RUN/lerobot`.
        profile: What is exported; `pointcloud`.
        config: Sizes of the clouds; None for the defaults.
        workers: Processes.
        overwrite: Whether a folder at `out` that no convert wrote may be replaced.

    Yields:
        One item per episode as it gets ready. The dataset is there when the iterator ends.

    Raises:
        DatasetError: No successful episodes, some without labels, an episode that cannot be
            converted, or something else at `out`. What was at `out` stays.
        ConfigError: No such profile.
    """
    if profile not in PROFILES:
        raise ConfigError(unknown_name("profile", profile, list(PROFILES)))
    config, out = config or CloudConfig(), out or run / "lerobot"
    _check_target(out, overwrite)
    chosen, left_out = choose_episodes(run)
    kept_in = run / ".cache" / "convert"
    with _exclusive(kept_in, run):
        code = code_fingerprint()
        jobs = [CloudJob(folder, config, kept_in, code) for folder in chosen]
        for i, (name, reused) in enumerate(_make_all(jobs, workers)):
            yield ConvertProgress(name, i + 1, len(jobs), reused)
        remove_partials(out.parent)
        with atomic_folder(out) as partial:
            _write_dataset(partial, run, jobs, chosen, left_out, profile)
        shutil.rmtree(kept_in, ignore_errors=True)


def choose_episodes(run: Path) -> tuple[dict[Path, EpisodeManifest], list[str]]:
    """Successful episodes of a run by folder, and the ids of those that did not succeed.

    Raises:
        DatasetError: None succeeded, or some that did have no labels; the message lists them.
    """
    manifests = {folder: load_manifest(folder) for folder in list_episodes(run)}
    chosen = {folder: m for folder, m in manifests.items() if m.success}
    left_out = [m.id for m in manifests.values() if not m.success]
    if not chosen:
        raise DatasetError(
            f"{run}: {len(left_out)} episodes, none of them successful; "
            f"run `codediffuser demo {run}` first"
        )
    bare = [m.id for folder, m in chosen.items() if not has_labels(folder)]
    if bare:
        listed = ", ".join(bare[:8]) + (f" and {len(bare) - 8} more" if len(bare) > 8 else "")
        raise DatasetError(
            f"{run}: {len(bare)} of {len(chosen)} successful episodes have no labels: {listed}; "
            f"run `codediffuser label {run} --auto`"
        )
    rates = sorted({m.hz for m in chosen.values()})
    if len(rates) > 1:
        raise DatasetError(f"{run}: episodes of several rates cannot share a dataset: {rates} Hz")
    return chosen, left_out


def _make_all(jobs: Sequence[CloudJob], workers: int) -> Iterator[tuple[str, bool]]:
    """Make what is not there yet; id of each episode, and whether it was there."""
    if workers <= 1:
        for job in jobs:
            yield job.folder.name, ensure_columns(job)
        return
    for outcome in run_tasks(ensure_columns, jobs, workers=workers):
        if outcome.error:
            raise DatasetError(f"episode {outcome.task.folder.name}: {outcome.error}")
        yield outcome.task.folder.name, bool(outcome.value)


def _write_dataset(
    root: Path,
    run: Path,
    jobs: Sequence[CloudJob],
    manifests: Mapping[Path, EpisodeManifest],
    left_out: Sequence[str],
    profile: str,
) -> None:
    config = jobs[0].config
    writer = LeRobotWriter(
        root,
        policy_features(config.num_points, config.model_dump(mode="json")),
        fps=manifests[jobs[0].folder].hz,
        robot_type=ROBOT_TYPE,
    )
    exported = []
    for index, job in enumerate(jobs):
        manifest, columns = manifests[job.folder], load_columns(job.path)
        _add_episode(writer, job.folder, manifest, columns)
        exported.append(
            ExportedEpisode(
                episode_index=index,
                episode_id=manifest.id,
                frames=len(columns.state),
                episode_sha256=episode_sha256(manifest),
                labels_revision=load_labels(job.folder).revision,
                labels_sha256=sha256_file(job.folder / LABELS_FILE),
            )
        )
    writer.finish()
    DatasetDocument(
        profile=profile,
        task=",".join(sorted({m.task for m in manifests.values()})),
        cloud=config,
        source=run.resolve().name,
        episodes=tuple(exported),
        left_out=tuple(left_out),
        versions=versions(),
        git_commit=git_commit(),
        content_sha256=dataset_fingerprint(root),
    ).save(root / DOCUMENT)


def _add_episode(
    writer: LeRobotWriter, folder: Path, manifest: EpisodeManifest, columns: EpisodeColumns
) -> None:
    length = len(columns.state)
    per_point = columns.points.reshape(-1, len(POINT_CHANNELS))
    writer.add_episode(
        {
            POINTS: columns.points,
            STATE: columns.state,
            ACTION: columns.action,
            LABELS: [labels_json(folder)] * length,
            EPISODE_ID: [manifest.id] * length,
        },
        manifest.instruction,
        {POINTS: feature_stats(per_point, count=length)},
    )


def _check_target(out: Path, overwrite: bool) -> None:
    if not out.exists() or overwrite:
        return
    if out.is_dir() and ((out / DOCUMENT).exists() or not any(out.iterdir())):
        return
    known = " (a LeRobot dataset of another origin)" if (out / INFO).exists() else ""
    raise DatasetError(
        f"{out}: exists and was not written by convert{known}; choose another --out, "
        "or give --overwrite"
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
