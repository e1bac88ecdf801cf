"""One shard, from its lease to its result; all executors run this."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import ClassVar

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.collect import record_scenes, settled_scenes
from codediffuser.datagen.demo_results import DemoResult
from codediffuser.datagen.episode import load_manifest
from codediffuser.datagen.physics_store import PHYSICS
from codediffuser.datagen.shards.lease import LEASE_S, LeaseLostError, holding, publish
from codediffuser.datagen.shards.plan import SHARDS, Shard, ShardPlan, plan_path
from codediffuser.errors import CodeDiffuserError, EpisodeError
from codediffuser.files import remove_partials, sha256_json
from codediffuser.schema import Document, Strict

DONE = "done"

_log = logging.getLogger(__name__)


class WorkerDiedError(CodeDiffuserError):
    """A worker ended without an answer; another one gets its shard."""


@dataclass(frozen=True, slots=True)
class ShardTask:
    """What a worker is sent; all else lies in the run folder, which it must see."""

    run: Path
    shard_id: str
    lease_s: float = LEASE_S


class SceneOutcome(Strict):
    """What came of one scene of a shard."""

    scene_id: str
    success: bool
    phase: str
    reason: str
    steps: int
    cameras: int
    bytes: int
    content_sha256: str
    """Of the episode's log; empty for a failure and for physics alone."""


class SceneTiming(Strict):
    """How a scene was made, which may differ from one run to the next."""

    physics_s: float
    render_s: float
    write_s: float
    tries: int
    rss_mb: float


class ShardResult(Document):
    """`done/<shard>.json` (`schema: codediffuser.shard_result/1`)."""

    KIND: ClassVar[str] = "shard_result"
    VERSION: ClassVar[int] = 1

    shard: str
    outcomes: tuple[SceneOutcome, ...]
    checksum: str
    """SHA-256 over the outcomes: whoever makes the shard gets the same."""
    timings: tuple[SceneTiming, ...]

    @property
    def whole(self) -> bool:
        """Whether every scene has an episode or a failure that would come again."""
        return not any(o.phase.startswith("process:") for o in self.outcomes)

    def results(self) -> list[DemoResult]:
        """The scenes as `demo` counts them."""
        shared = {f.name for f in fields(DemoResult)}
        return [
            DemoResult(
                **{k: v for k, v in outcome.model_dump().items() if k in shared},
                **timing.model_dump(),
            )
            for outcome, timing in zip(self.outcomes, self.timings, strict=True)
        ]


def result_path(run: Path, shard_id: str) -> Path:
    """Where the result of a shard lies."""
    return run / SHARDS / DONE / f"{shard_id}.json"


def run_shard(task: ShardTask, on_scene: Callable[[DemoResult], None] | None = None) -> ShardResult:
    """Record the scenes of a shard that are not settled yet, and publish what came of all.

    A shard that is done is not touched. Episodes are made in a process of their own, which ends
    with the shard, so neither leaks nor hangs reach the caller.

    Args:
        task: Which shard of which run.
        on_scene: Told of every scene as it is done.

    Raises:
        LeaseHeldError: Somebody else works on it.
        LeaseLostError: It took so long without a sign of life that somebody else has taken it.
        EpisodeError: The shard was made before, with other content.
    """
    if (done := find_result(task.run, task.shard_id)) is not None:
        return done
    plan = ShardPlan.load(plan_path(task.run))
    shard, options = plan.shard(task.shard_id), plan.options
    with holding(task.run, shard.id, task.lease_s) as lost:
        # Nobody else may write these now, so what is half-written was left by a dead holder.
        for folder in (fmt.EPISODES, PHYSICS):
            remove_partials(task.run / folder, shard.scene_ids)
        jobs = [options.job(task.run, scene_id) for scene_id in shard.scene_ids]
        results = settled_scenes(jobs)
        waiting = [job for job in jobs if job.scene_id not in results]
        for result in record_scenes(waiting, options):
            if lost.is_set():
                raise LeaseLostError(f"shard {shard.id}: its lease ran out while it was made")
            results[result.scene_id] = result
            if on_scene is not None:
                on_scene(result)
        return _publish(task.run, shard, [results[name] for name in shard.scene_ids])


def find_result(run: Path, shard_id: str) -> ShardResult | None:
    """The result of a shard, if it is done and its episodes are there as it says."""
    path = result_path(run, shard_id)
    if not path.is_file():
        return None
    result = ShardResult.load(path)
    for outcome in result.outcomes:
        if outcome.content_sha256 and outcome.content_sha256 != _content(run, outcome.scene_id):
            _log.warning("%s: episode %s is not the one it tells of", path, outcome.scene_id)
            return None
    return result


def forget_result(run: Path, shard_id: str) -> None:
    """Let a shard be made again."""
    result_path(run, shard_id).unlink(missing_ok=True)


def _publish(run: Path, shard: Shard, results: list[DemoResult]) -> ShardResult:
    outcomes = tuple(_outcome(run, r) for r in results)
    result = ShardResult(
        shard=shard.id,
        outcomes=outcomes,
        checksum=sha256_json([o.model_dump() for o in outcomes]),
        timings=tuple(
            SceneTiming(**{name: getattr(r, name) for name in SceneTiming.model_fields})
            for r in results
        ),
    )
    path = result_path(run, shard.id)
    if not publish(result, path):
        first = ShardResult.load(path)
        if first.whole and result.whole and first.checksum != result.checksum:
            raise EpisodeError(
                f"{path}: shard {shard.id} was made twice with different content, checksums "
                f"{first.checksum[:12]} and {result.checksum[:12]}; machines must run the same "
                "versions, see 'versions' in the episodes' manifests"
            )
        return first
    return result


def _outcome(run: Path, result: DemoResult) -> SceneOutcome:
    wanted = {k: getattr(result, k) for k in SceneOutcome.model_fields if k != "content_sha256"}
    digest = _content(run, result.scene_id) if result.bytes else ""
    return SceneOutcome(**wanted, content_sha256=digest)


def _content(run: Path, scene_id: str) -> str:
    """Hash of an episode's log by its manifest; empty when there is no episode."""
    try:
        return load_manifest(run / fmt.EPISODES / scene_id).content_hash
    except EpisodeError:
        return ""


def as_earlier(results: list[DemoResult]) -> list[DemoResult]:
    """Results that were found, not made."""
    return [replace(r, earlier=True) for r in results]
