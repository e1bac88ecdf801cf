"""What the physics phase leaves for the rendering phase: `RUN/physics/<id>/`.

Only successes are kept here; failures are recorded beside the episodes. The folder of a scene goes
when its episode is written, which holds the same states.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from codediffuser.datagen.episode_format import STATES, ConditionRecord
from codediffuser.datagen.recovery import Recovery
from codediffuser.datagen.scene import scene_path
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import CodeDiffuserError
from codediffuser.files import atomic_folder, sha256_file
from codediffuser.schema import Document

PHYSICS = "physics"
RECORD = "physics.json"

_log = logging.getLogger(__name__)


class PhysicsRecord(Document):
    """`physics.json` (`schema: codediffuser.physics/1`)."""

    KIND: ClassVar[str] = "physics"
    VERSION: ClassVar[int] = 1

    scene_id: str
    scene_sha256: str
    recovery_probability: float
    recovery: Recovery | None
    conditions: tuple[ConditionRecord, ...]
    states_sha256: str


@dataclass(frozen=True, slots=True)
class Physics:
    """A successful demonstration without pictures."""

    trajectory: Trajectory
    conditions: tuple[ConditionRecord, ...]
    recovery: Recovery | None


def physics_folder(run: Path, scene_id: str) -> Path:
    """Where a scene's states wait for pictures."""
    return run / PHYSICS / scene_id


def save_physics(run: Path, scene_id: str, physics: Physics, probability: float) -> None:
    """Write a scene's folder whole or not at all.

    Args:
        run: Run folder, with the scene.
        scene_id: Which scene.
        physics: What came of it.
        probability: Share of recovery demonstrations that was asked for.
    """
    with atomic_folder(physics_folder(run, scene_id)) as partial:
        physics.trajectory.save(partial / STATES)
        PhysicsRecord(
            scene_id=scene_id,
            scene_sha256=sha256_file(scene_path(run, scene_id)),
            recovery_probability=probability,
            recovery=physics.recovery,
            conditions=physics.conditions,
            states_sha256=sha256_file(partial / STATES),
        ).save(partial / RECORD)


def find_record(run: Path, scene_id: str, probability: float) -> PhysicsRecord | None:
    """The record of a scene, if there is one of the scene file as it is and the same settings."""
    path = physics_folder(run, scene_id) / RECORD
    if not path.is_file():
        return None
    record = PhysicsRecord.load(path)
    wanted = (sha256_file(scene_path(run, scene_id)), probability)
    return record if (record.scene_sha256, record.recovery_probability) == wanted else None


def load_physics(run: Path, scene_id: str, probability: float) -> Physics | None:
    """What `save_physics` wrote for the same scene and settings; None when it has to be made."""
    states = physics_folder(run, scene_id) / STATES
    try:
        record = find_record(run, scene_id, probability)
        if record is None:
            return None
        if sha256_file(states) != record.states_sha256:
            _log.warning("%s: not what was written; simulated again", states)
            return None
        return Physics(Trajectory.load(states), record.conditions, record.recovery)
    except (CodeDiffuserError, OSError) as error:
        _log.warning("%s; simulated again", error)
        return None


def forget_physics(run: Path, scene_id: str) -> None:
    """Delete a scene's folder, once its episode holds the states."""
    shutil.rmtree(physics_folder(run, scene_id), ignore_errors=True)
