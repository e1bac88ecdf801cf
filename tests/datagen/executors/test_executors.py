"""Every executor runs the same `run_shard` and ends with the same states, to the byte."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from codediffuser.datagen.collect import CollectOptions, collect_demos
from codediffuser.datagen.executors.local import LocalExecutor
from codediffuser.datagen.executors.slurm import ShardCall, SlurmExecutor, SlurmOptions
from codediffuser.datagen.scene import scene_path
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.shards.drive import Executor, collect_shards
from codediffuser.datagen.shards.run import ShardTask
from codediffuser.datagen.task import get_task
from codediffuser.errors import SetupError
from codediffuser.files import sha256_file

PHYSICS = CollectOptions(physics_only=True, recovery=0.5)


def write_scenes(run: Path) -> None:
    for index in range(2):
        scene = sample_scene(get_task("pack_battery"), root_seed=3, index=index)
        scene.save(scene_path(run, scene.scene_id))


def states(run: Path) -> dict[str, str]:
    return {p.parent.name: sha256_file(p) for p in sorted(run.glob("physics/*/states.npz"))}


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What two processes without a plan give."""
    run = tmp_path_factory.mktemp("plain")
    write_scenes(run)
    assert all(r.success for r in collect_demos(run, PHYSICS, workers=2))
    return states(run)


@pytest.fixture
def ray_executor() -> Iterator[Any]:
    ray = pytest.importorskip("ray")
    from codediffuser.datagen.executors.ray import RayExecutor

    yield functools.partial(RayExecutor, workers=1)
    ray.shutdown()


def local(_: Path) -> Executor:
    return LocalExecutor(workers=2)


def slurm(run: Path) -> Executor:
    pytest.importorskip("submitit")
    return SlurmExecutor(run / "slurm", workers=1, options=SlurmOptions(cluster="debug"))


@pytest.mark.slow
@pytest.mark.parametrize("make", [local, slurm])
def test_an_executor_gives_the_states_of_plain_processes(
    make: Callable[[Path], Executor], tmp_path: Path, expected: dict[str, str]
) -> None:
    write_scenes(tmp_path)
    results = list(collect_shards(tmp_path, make(tmp_path), PHYSICS, shard_size=1))
    assert sorted(r.scene_id for r in results if r.success) == sorted(expected)
    assert states(tmp_path) == expected


@pytest.mark.slow
def test_ray_gives_the_states_of_plain_processes(
    ray_executor: Any, tmp_path: Path, expected: dict[str, str]
) -> None:
    write_scenes(tmp_path)
    results = list(collect_shards(tmp_path, ray_executor(), PHYSICS, shard_size=2))
    assert sorted(r.scene_id for r in results if r.success) == sorted(expected)
    assert states(tmp_path) == expected


def test_an_error_of_the_users_arrives_as_what_it_is(tmp_path: Path) -> None:
    task = ShardTask(tmp_path, "0000")
    answer = ShardCall()(task)
    assert answer is not None and "no such shard_plan file" in str(answer)
    (ended,) = LocalExecutor().run([task])
    assert ended[0] == task and "no such shard_plan file" in str(ended[1])


def test_a_stopped_slurm_job_goes_on_with_the_same_shard(tmp_path: Path) -> None:
    pytest.importorskip("submitit")
    task = ShardTask(tmp_path, "0000")
    again = ShardCall().checkpoint(task)
    assert isinstance(again.function, ShardCall) and again.args == (task,)


def test_without_slurm_the_error_says_what_to_try(tmp_path: Path) -> None:
    pytest.importorskip("submitit")
    with pytest.raises(SetupError, match=r"no Slurm on this machine .* --slurm-cluster local"):
        SlurmExecutor(tmp_path, options=SlurmOptions(cluster="slurm"))
