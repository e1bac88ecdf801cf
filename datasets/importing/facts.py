"""What the manifest of an imported episode says: instruction, outcome, scene, origin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datagen.episode_format import RecordingRecord
from codediffuser.datagen.episode_writer import EpisodeFacts
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datasets.importing.array_file import ArrayFile
from codediffuser.datasets.importing.array_steps import ArraySteps
from codediffuser.datasets.importing.bag_steps import BagSteps
from codediffuser.datasets.importing.bag_sync import SyncedEpisode
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.decoding import Decoder
from codediffuser.datasets.importing.jobs import Job
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.values import text_of
from codediffuser.errors import DatasetError
from codediffuser.files import sha256_json


def config_hash(config: ImportConfig) -> str:
    """SHA-256 of what a configuration says, whatever the file looks like."""
    return sha256_json(config.model_dump(mode="json", by_alias=True))


def episode_facts(
    job: Job,
    config: ImportConfig,
    success: bool,
    instruction: str,
    steps: BagSteps | ArraySteps,
    record: RecordingRecord,
) -> EpisodeFacts:
    """What the manifest says of an episode.

    Raises:
        DatasetError: Nothing says what was asked, or the scene is of another task.
    """
    seed = None
    if job.scene is not None:
        scene = SceneSpec.load(job.scene)
        if scene.task != config.task:
            raise DatasetError(f"{job.scene}: is a scene of {scene.task}, not of {config.task}")
        seed, instruction = scene.seed, scene.instruction.text
    if not instruction:
        raise DatasetError(
            "nothing says what was asked: set instruction, instruction_topic or scenes"
        )
    return EpisodeFacts(
        id=job.id,
        task=config.task,
        source=config.source,
        instruction=instruction,
        success=success,
        seed=seed,
        reason="" if success else "recorded as a failure",
        motion=steps.motion,
        recording=record,
    )


def recording_record(
    source: Recording | ArrayFile,
    job: Job,
    config: ImportConfig,
    damage: Sequence[str],
    synced: SyncedEpisode | None = None,
) -> RecordingRecord:
    """Where an episode comes from, and how it was synchronised."""
    return RecordingRecord(
        path=job.source.name,
        format=source.format,
        segment=job.segment,
        start_ns=job.start_ns,
        stop_ns=job.stop_ns,
        config_sha256=config_hash(config),
        damage=tuple(dict.fromkeys(damage)),
        sync=None if synced is None else synced.record,
    )


def instruction_at(recording: Recording, job: Job, config: ImportConfig) -> str:
    """The latest text at the start of an episode, or else the first within; empty for none."""
    topic = config.instruction_topic
    if not topic:
        return ""
    recording.topic(topic, "instruction_topic")
    times = recording.times_ns[topic]
    before = np.flatnonzero(times <= job.start_ns)
    within = np.flatnonzero((times > job.start_ns) & (times <= job.stop_ns))
    if not len(before) and not len(within):
        return ""
    i = int(before[np.argmax(times[before])]) if len(before) else int(within[0])
    return text_of(Decoder(recording.topics[topic]).decode(recording.read(topic, i))) or ""
