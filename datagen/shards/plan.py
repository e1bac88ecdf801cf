"""The durable plan: which scenes make which shard, and how all of them are recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from codediffuser.datagen.collect import CollectOptions, scene_ids
from codediffuser.datagen.pictures import PictureOptions
from codediffuser.datagen.scene import scene_path
from codediffuser.errors import ConfigError
from codediffuser.files import sha256_file
from codediffuser.schema import Document, Strict

SHARDS = "shards"
PLAN = "plan.json"
SHARD_SIZE = 20
"""Scenes of a shard: minutes of work, so that starting a process for it weighs little."""


class Shard(Strict):
    """Scenes that one worker records in one go."""

    id: str
    """Four digits."""
    scene_ids: tuple[str, ...]


class ShardPlan(Document):
    """`plan.json` (`schema: codediffuser.shard_plan/1`)."""

    KIND: ClassVar[str] = "shard_plan"
    VERSION: ClassVar[int] = 1

    pictures: PictureOptions
    recovery: float
    physics_only: bool
    timeout_s: float
    scenes: dict[str, str]
    """Scene id to the SHA-256 of its file."""
    shards: tuple[Shard, ...]

    @property
    def options(self) -> CollectOptions:
        """How the scenes are recorded."""
        return CollectOptions(
            pictures=self.pictures,
            recovery=self.recovery,
            physics_only=self.physics_only,
            timeout_s=self.timeout_s,
        )

    def shard(self, shard_id: str) -> Shard:
        """The shard with this id; `KeyError` when there is none."""
        return {shard.id: shard for shard in self.shards}[shard_id]


def plan_path(run: Path) -> Path:
    """Where a run's plan lies."""
    return run / SHARDS / PLAN


def make_plan(run: Path, options: CollectOptions, shard_size: int = SHARD_SIZE) -> ShardPlan:
    """Write the plan of a run, or take up the one that is there.

    Scenes that were sampled since get shards of their own; the older shards stay as they are.

    Raises:
        ConfigError: The run has no scenes, or its plan is for other scenes or other settings.
    """
    if shard_size < 1:
        raise ConfigError(f"shard size: expected at least 1 scene, got {shard_size}")
    scenes = {name: sha256_file(scene_path(run, name)) for name in scene_ids(run)}
    path = plan_path(run)
    old = ShardPlan.load(path) if path.is_file() and not options.overwrite else None
    fresh = ShardPlan(
        pictures=options.pictures,
        recovery=options.recovery,
        physics_only=options.physics_only,
        timeout_s=options.timeout_s,
        scenes=scenes,
        shards=_cut(list(scenes), shard_size, ()),
    )
    if old is not None:
        _check_same(old, fresh, path)
        new = [name for name in scenes if name not in old.scenes]
        fresh = fresh.model_copy(update={"shards": _cut(new, shard_size, old.shards)})
    fresh.save(path)
    return fresh


def _cut(names: Sequence[str], size: int, before: tuple[Shard, ...]) -> tuple[Shard, ...]:
    parts = [tuple(names[i : i + size]) for i in range(0, len(names), size)]
    numbered = enumerate(parts, start=len(before))
    return (*before, *(Shard(id=f"{number:04d}", scene_ids=part) for number, part in numbered))


def _check_same(old: ShardPlan, new: ShardPlan, path: Path) -> None:
    """Refuse to go on with a plan that was made for something else."""
    for key in ("pictures", "recovery", "physics_only"):
        if getattr(old, key) != getattr(new, key):
            raise ConfigError(
                f"{path}: was made with other {key.replace('_', ' ')}; use the options of the "
                "first call, another run folder, or --overwrite to record everything again"
            )
    changed = [name for name, digest in old.scenes.items() if new.scenes.get(name) != digest]
    if changed:
        raise ConfigError(
            f"{path}: {len(changed)} scenes are gone or changed since it was made, the first is "
            f"{changed[0]}; use another run folder, or --overwrite to record everything again"
        )
