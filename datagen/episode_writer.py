"""Writes one episode folder, whole or not at all: log, scene, states, manifest."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from mcap.reader import make_reader

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.episode_format import (
    Camera,
    CameraRecord,
    ConditionRecord,
    EpisodeManifest,
    FileRecord,
    ImageOptions,
    MotionRecord,
    RecordingRecord,
)
from codediffuser.datagen.log_step import LogStep
from codediffuser.datagen.log_writer import LogWriter
from codediffuser.datagen.scene import SeedKey
from codediffuser.datagen.trajectory import CONTROL_HZ, Trajectory
from codediffuser.errors import EpisodeError
from codediffuser.files import atomic_folder, sha256_file
from codediffuser.manifest import git_commit, versions
from codediffuser.schema import Document


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """What the manifest says that the log does not."""

    id: str
    task: str
    source: Literal["simulation", "real"]
    instruction: str
    success: bool
    seed: SeedKey | None = None
    reason: str = ""
    conditions: tuple[ConditionRecord, ...] = ()
    motion: MotionRecord = field(default_factory=MotionRecord)
    recording: RecordingRecord | None = None


def write_episode(
    folder: Path,
    facts: EpisodeFacts,
    cameras: Mapping[str, Camera],
    steps: Iterable[LogStep],
    *,
    hz: int = CONTROL_HZ,
    image: ImageOptions | None = None,
    joint_names: tuple[str, ...] = fmt.PANDA_JOINT_NAMES,
    scene_file: Path | None = None,
    trajectory: Trajectory | None = None,
    sync: Callable[[], Mapping[str, np.ndarray]] | None = None,
    records: Sequence[CameraRecord] | None = None,
    documents: Mapping[str, Document] | None = None,
    keep: Iterable[Path] = (),
) -> EpisodeManifest:
    """Write an episode folder whole or not at all; an older folder of that name is replaced.

    Args:
        folder: `RUN/episodes/<id>`.
        facts: What the manifest says of it.
        cameras: Calibration by camera name.
        steps: Control steps in time order; consumed as they are written.
        hz: Control steps per second.
        image: How colour is stored.
        joint_names: Names in the order of `LogStep.qpos`.
        scene_file: The scene it was reset to, copied byte for byte.
        trajectory: Simulator states, stored beside the log.
        sync: Gives, once all steps are consumed, the arrays of `sync.npz`.
        records: What each camera brings at every step; None: all of `cameras`, colour and depth.
        documents: Further records by file name, written and listed.
        keep: Further files that are copied into the folder and not listed, such as labels.

    Raises:
        EpisodeError: No step was given, or what was written does not read back.
        ShapeError: A step does not follow its contract.
    """
    image = image or ImageOptions()
    with atomic_folder(folder) as partial:
        with (partial / fmt.LOG).open("wb") as stream:
            log = LogWriter(
                stream, cameras, facts.instruction, hz=hz, image=image,
                joint_names=joint_names, motion=facts.motion, records=records,
            )  # fmt: skip
            with log:
                for step in steps:
                    log.add_step(step)
        if log.num_steps == 0:
            raise EpisodeError(f"{folder}: an episode needs at least one step, got none")
        _verify_log(partial / fmt.LOG, log.counts)
        if scene_file is not None:
            shutil.copyfile(scene_file, partial / fmt.SCENE)
        if trajectory is not None:
            trajectory.save(partial / fmt.STATES)
        if sync is not None:
            np.savez(partial / fmt.SYNC, **dict(sync()))  # type: ignore[arg-type]
        for name, document in (documents or {}).items():
            document.save(partial / name)
        manifest = _manifest(partial, facts, log, hz, image)
        manifest.save(partial / fmt.MANIFEST)
        for path in keep:
            shutil.copyfile(path, partial / path.name)
    return manifest


def _manifest(
    partial: Path,
    facts: EpisodeFacts,
    log: LogWriter,
    hz: int,
    image: ImageOptions,
) -> EpisodeManifest:
    files = {
        path.name: FileRecord(bytes=path.stat().st_size, sha256=sha256_file(path))
        for path in sorted(partial.iterdir())
    }
    return EpisodeManifest(
        id=facts.id,
        task=facts.task,
        source=facts.source,
        seed=facts.seed,
        instruction=facts.instruction,
        success=facts.success,
        reason=facts.reason,
        conditions=facts.conditions,
        frames=log.num_steps,
        hz=hz,
        cameras=log.records,
        motion=facts.motion,
        recording=facts.recording,
        image=image,
        topics=log.counts,
        versions=versions(),
        git_commit=git_commit(),
        files=files,
    )


def _verify_log(path: Path, expected: Mapping[str, int]) -> None:
    """Read every message back, checksums included, and count by topic."""
    counts = dict.fromkeys(expected, 0)
    with path.open("rb") as stream:
        for _, channel, _ in make_reader(stream, validate_crcs=True).iter_messages():
            counts[channel.topic] += 1
    if counts != dict(expected):
        raise EpisodeError(f"{path}: wrote {dict(expected)} messages, read back {counts}")
