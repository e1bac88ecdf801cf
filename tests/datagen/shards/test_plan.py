"""The plan of a run: the same on every call, extended by new scenes, refused for other settings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from codediffuser.datagen.collect import CollectOptions
from codediffuser.datagen.pictures import NamedRanges, PictureOptions
from codediffuser.datagen.randomization import load_randomization
from codediffuser.datagen.scene import SceneSpec, scene_path
from codediffuser.datagen.shards.plan import ShardPlan, make_plan, plan_path
from codediffuser.errors import ConfigError

AddScenes = Callable[[int, int], None]


@pytest.fixture
def add_scenes(tmp_path: Path, small_scene: SceneSpec) -> AddScenes:
    def add(start: int, stop: int) -> None:
        for index in range(start, stop):
            name = f"{index:06d}"
            scene = small_scene.model_copy(update={"scene_id": name})
            scene.save(scene_path(tmp_path, name))

    return add


def sizes(plan: ShardPlan) -> list[int]:
    return [len(shard.scene_ids) for shard in plan.shards]


def test_every_scene_is_in_one_shard(tmp_path: Path, add_scenes: AddScenes) -> None:
    add_scenes(0, 7)
    plan = make_plan(tmp_path, CollectOptions(), shard_size=3)
    assert sizes(plan) == [3, 3, 1]
    assert [i for shard in plan.shards for i in shard.scene_ids] == sorted(plan.scenes)
    assert plan.shard("0002").scene_ids == ("000006",)


def test_a_second_call_takes_up_the_plan_whatever_shard_size_it_asks_for(
    tmp_path: Path, add_scenes: AddScenes
) -> None:
    add_scenes(0, 4)
    first = make_plan(tmp_path, CollectOptions(), shard_size=2)
    assert make_plan(tmp_path, CollectOptions(), shard_size=3) == first


def test_scenes_that_come_later_get_shards_of_their_own(
    tmp_path: Path, add_scenes: AddScenes
) -> None:
    add_scenes(0, 3)
    first = make_plan(tmp_path, CollectOptions(), shard_size=2)
    add_scenes(3, 6)
    second = make_plan(tmp_path, CollectOptions(), shard_size=2)
    assert second.shards[: len(first.shards)] == first.shards
    assert sizes(second) == [2, 1, 2, 1]


def test_all_settings_survive_the_file(tmp_path: Path, add_scenes: AddScenes) -> None:
    add_scenes(0, 1)
    ranges = NamedRanges(name="strong", ranges=load_randomization("strong"))
    pictures = PictureOptions(width=64, height=48, looks=ranges)
    options = CollectOptions(pictures=pictures, recovery=0.25, physics_only=True, timeout_s=9)
    make_plan(tmp_path, options)
    assert ShardPlan.load(plan_path(tmp_path)).options == options


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (CollectOptions(recovery=0.5), "other recovery"),
        (CollectOptions(physics_only=True), "other physics only"),
        (CollectOptions(pictures=PictureOptions(width=64)), "other pictures"),
    ],
)
def test_other_settings_are_refused_and_overwrite_takes_them(
    tmp_path: Path, add_scenes: AddScenes, options: CollectOptions, what: str
) -> None:
    add_scenes(0, 2)
    make_plan(tmp_path, CollectOptions())
    with pytest.raises(ConfigError, match=f"{what}; use the options of the first call"):
        make_plan(tmp_path, options)


def test_changed_scenes_are_refused(
    tmp_path: Path, add_scenes: AddScenes, small_scene: SceneSpec
) -> None:
    add_scenes(0, 2)
    make_plan(tmp_path, CollectOptions())
    changed = small_scene.model_copy(update={"scene_id": "000001", "split": "val"})
    changed.save(scene_path(tmp_path, "000001"))
    with pytest.raises(ConfigError, match=r"1 scenes are gone or changed .* the first is 000001"):
        make_plan(tmp_path, CollectOptions())


def test_a_shard_of_no_scenes_is_refused(tmp_path: Path, add_scenes: AddScenes) -> None:
    add_scenes(0, 1)
    with pytest.raises(ConfigError, match="expected at least 1 scene, got 0"):
        make_plan(tmp_path, CollectOptions(), shard_size=0)
