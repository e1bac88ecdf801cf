"""A plan is run to its end whatever happens to workers: nothing lost, nothing twice.

The simulator is replaced by a writer of synthetic episodes; leases, results and rounds are real.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from codediffuser.datagen.collect import CollectOptions
from codediffuser.datagen.demo_results import DemoFailure, DemoResult, failure_path
from codediffuser.datagen.episode import load_manifest
from codediffuser.datagen.record import DemoJob
from codediffuser.datagen.scene import SceneSpec, scene_path
from codediffuser.datagen.shards import run as shard_run
from codediffuser.datagen.shards.drive import MAX_ROUNDS, collect_shards
from codediffuser.datagen.shards.lease import LeaseHeldError, holding, take
from codediffuser.datagen.shards.run import (
    ShardResult,
    ShardTask,
    WorkerDiedError,
    find_result,
    result_path,
    run_shard,
)
from codediffuser.errors import EpisodeError, SetupError, StorageError
from codediffuser.files import TEMPORARY_PREFIX, sha256_file

IDS = tuple(f"{i:06d}" for i in range(5))


class Lab:
    """A run of five scenes whose episodes are written without a simulator."""

    def __init__(self, run: Path, write: Callable[..., tuple[Path, Any, Any]]) -> None:
        self.run, self.write = run, write
        self.made: list[str] = []
        self.fails: set[str] = set()
        self.hangs: set[str] = set()
        self.dies_after: int | None = None
        self.death: Exception = ConnectionError("the node is gone")

    def record(self, jobs: Sequence[DemoJob], _: CollectOptions) -> Iterator[DemoResult]:
        for job in jobs:
            if self.dies_after is not None and len(self.made) >= self.dies_after:
                self.dies_after = None
                raise self.death
            self.made.append(job.scene_id)
            cause = "expert" if job.scene_id in self.fails else "process"
            if job.scene_id in self.fails | self.hangs:
                failure = DemoFailure(
                    scene_id=job.scene_id, scene_sha256=sha256_file(job.scene_file), cause=cause,
                    phase="grasp:missed" if cause == "expert" else "process:hung", reason="why",
                )  # fmt: skip
                failure.save(failure_path(job.run, job.scene_id))
                yield DemoResult.of_failure(failure)
            else:
                folder, _, _ = self.write(job.run, job.scene_id)
                yield DemoResult.of_episode(load_manifest(folder))

    def collect(self, executor: Here | None = None, **options: Any) -> dict[str, DemoResult]:
        self.made.clear()
        found = collect_shards(
            self.run, executor or Here(), CollectOptions(**options), shard_size=2,
            sleep=lambda _: None,
        )  # fmt: skip
        results = list(found)
        assert len(results) == len({r.scene_id for r in results}), "a scene is reported once"
        return {r.scene_id: r for r in results}


class Here:
    """The executor of this process."""

    workers = 1

    def run(self, tasks: Sequence[ShardTask]) -> Iterator[tuple[ShardTask, Exception | None]]:
        for task in tasks:
            try:
                run_shard(task)
                yield task, None
            except Exception as error:
                yield task, error


@pytest.fixture
def lab(
    tmp_path: Path,
    small_scene: SceneSpec,
    write_synthetic_episode: Callable[..., tuple[Path, Any, Any]],
    monkeypatch: pytest.MonkeyPatch,
) -> Lab:
    for name in IDS:
        small_scene.model_copy(update={"scene_id": name}).save(scene_path(tmp_path, name))
    lab = Lab(tmp_path, write_synthetic_episode)
    monkeypatch.setattr(shard_run, "record_scenes", lab.record)
    return lab


def test_every_scene_gets_its_episode_and_the_run_its_summary(lab: Lab) -> None:
    results = lab.collect()
    assert sorted(results) == list(IDS)
    assert all(r.success and not r.earlier for r in results.values())
    summary = json.loads((lab.run / "demo_summary.json").read_text())
    assert (summary["scenes"], summary["episodes"]) == (5, 5)
    done = ShardResult.load(result_path(lab.run, "0002"))
    assert done.outcomes[0].content_sha256 == load_manifest(
        lab.run / "episodes" / IDS[4]
    ).content_hash  # fmt: skip


def test_a_second_call_finds_all_done(lab: Lab) -> None:
    lab.collect()
    assert all(r.earlier for r in lab.collect().values())
    assert lab.made == []


def test_a_worker_that_dies_midway_loses_nothing_and_repeats_nothing(lab: Lab) -> None:
    lab.dies_after = 3
    results = lab.collect()
    assert sorted(results) == list(IDS)
    assert sorted(lab.made) == list(IDS)


def test_a_worker_that_died_is_told_in_one_line(lab: Lab, caplog: pytest.LogCaptureFixture) -> None:
    lab.dies_after, lab.death = 3, WorkerDiedError("a worker died: killed")
    assert sorted(lab.collect()) == list(IDS)
    (record,) = caplog.records
    assert record.getMessage() == "shard 0001 is given out again: a worker died: killed"
    assert not record.exc_info


def test_a_shard_that_always_fails_ends_with_its_last_reason(lab: Lab) -> None:
    class Broken(Here):
        def run(self, tasks: Sequence[ShardTask]) -> Iterator[tuple[ShardTask, Exception | None]]:
            for task in tasks:
                yield task, ConnectionError("no route")

    with pytest.raises(SetupError, match=rf"failed {MAX_ROUNDS} times, last: no route"):
        lab.collect(Broken())


def test_an_error_of_the_users_ends_all_at_once(lab: Lab) -> None:
    class Full(Here):
        def run(self, tasks: Sequence[ShardTask]) -> Iterator[tuple[ShardTask, Exception | None]]:
            yield tasks[0], StorageError("disk full")

    with pytest.raises(StorageError, match="disk full"):
        lab.collect(Full())


def test_a_lost_episode_is_made_again_and_others_are_not(lab: Lab) -> None:
    lab.collect()
    (lab.run / "episodes" / IDS[3] / "episode.json").unlink()
    assert sorted(lab.collect()) == list(IDS)
    assert lab.made == [IDS[3]]


def test_an_experts_failure_stays_and_a_hung_process_is_tried_by_the_next_call(lab: Lab) -> None:
    lab.fails, lab.hangs = {IDS[0]}, {IDS[3]}
    first = lab.collect()
    assert (first[IDS[0]].phase, first[IDS[3]].phase) == ("grasp:missed", "process:hung")
    lab.hangs = set()
    second = lab.collect()
    assert lab.made == [IDS[3]]
    assert second[IDS[3]].success and not second[IDS[0]].success


def test_overwrite_makes_all_again(lab: Lab) -> None:
    lab.collect()
    lab.collect(overwrite=True)
    assert sorted(lab.made) == list(IDS)


def test_a_shard_somebody_works_on_is_left_to_them(lab: Lab) -> None:
    lab.collect()
    result_path(lab.run, "0001").unlink()
    lab.made.clear()
    with holding(lab.run, "0001"), pytest.raises(LeaseHeldError):
        run_shard(ShardTask(lab.run, "0001"))
    assert lab.made == []


def test_what_a_dead_machine_left_of_a_shard_is_removed_with_its_lease(lab: Lab) -> None:
    lab.collect()
    result_path(lab.run, "0001").unlink()
    episodes = lab.run / "episodes"
    mine, other = (episodes / f"{TEMPORARY_PREFIX}1@elsewhere-{i}" for i in (IDS[2], IDS[4]))
    mine.mkdir()
    other.mkdir()
    run_shard(ShardTask(lab.run, "0001"))
    assert not mine.exists()
    assert other.exists(), "a scene of another shard"


def test_two_makers_of_one_shard_publish_one_result(lab: Lab) -> None:
    lab.collect()
    first = result_path(lab.run, "0000")
    before = first.read_bytes()
    assert run_shard(ShardTask(lab.run, "0000")) == find_result(lab.run, "0000")
    assert first.read_bytes() == before


def test_different_content_of_one_shard_is_an_error(lab: Lab, monkeypatch: Any) -> None:
    lab.collect()
    path = result_path(lab.run, "0000")
    done = ShardResult.load(path)
    done.model_copy(update={"checksum": "0" * 64}).save(path)
    monkeypatch.setattr(shard_run, "find_result", lambda *_: None)
    with pytest.raises(EpisodeError, match=r"made twice with different content.*same versions"):
        run_shard(ShardTask(lab.run, "0000"))


def test_a_free_lease_is_left_behind_by_nobody(lab: Lab) -> None:
    lab.collect()
    assert list((lab.run / "shards" / "leases").iterdir()) == []
    take(lab.run, "0000")
