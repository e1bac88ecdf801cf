from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import Task, get_task
from codediffuser.labeling.perception.evaluate import SceneScore, judge, report, true_instances
from codediffuser.labeling.perception.finding import FoundInstance
from codediffuser.labeling.perception.rendered import StartScene, seen_places
from codediffuser.labeling.perception.views import views_at


@pytest.fixture
def task() -> Task:
    return get_task("pack_battery")


@pytest.fixture
def start(write_battery_episode: Callable[..., Path], tmp_path: Path) -> StartScene:
    episode = Episode.open(write_battery_episode(tmp_path))
    T_start = {"battery_0": episode.trajectory.T_world_object("battery_0", 0)}
    views = views_at(episode)
    return StartScene(episode.scene, T_start, views, np.zeros((len(views), 1, 1), np.int16))


@pytest.fixture
def perfect(task: Task, start: StartScene) -> list[FoundInstance]:
    """What is there, as if perception had found it."""
    return [
        FoundInstance(
            t.category, t.points_world, np.zeros((len(t.points_world), 3), np.uint8),
            t.points_world.mean(axis=0).astype(np.float64), 1.0,
        )
        for t in true_instances(task, start)
    ]  # fmt: skip


def test_what_is_there_is_right(
    task: Task, start: StartScene, perfect: list[FoundInstance]
) -> None:
    score = judge(task, start, perfect)
    assert score.right == score.found == score.true == Counter(battery=1, slot=2)
    assert score.attention
    assert score.faults == ()


def test_a_missing_and_a_spurious_instance_are_named(
    task: Task, start: StartScene, perfect: list[FoundInstance]
) -> None:
    battery, *slots = perfect
    ghost = replace(battery, points_world=battery.points_world + np.float32(0.2))
    score = judge(task, start, [ghost, *slots])
    assert score.right == Counter(slot=2)
    assert not score.attention
    assert [f.split(" ")[0] for f in score.faults] == ["battery_0", "a"]


def test_half_of_an_instance_is_not_right(
    task: Task, start: StartScene, perfect: list[FoundInstance]
) -> None:
    battery, *slots = perfect
    half = replace(battery, points_world=battery.points_world[::3])
    assert judge(task, start, [half, *slots]).right["battery"] == 0


def test_the_place_that_an_object_fills_is_the_object(task: Task, start: StartScene) -> None:
    scene = start.scene
    assert len(seen_places(task, scene)) == 2
    slot = scene.place("slot_1")
    battery = scene.object("battery_0").model_copy(
        update={"id": "battery_1", "place": slot.id, "position_m": slot.position_m}
    )
    there = scene.model_copy(update={"objects": (*scene.objects, battery)})
    assert len(seen_places(task, there)) == 2  # a cell shows its walls
    tight = slot.model_copy(
        update={"size_m": (0.031, 0.031, 0.061), "center_m": (*slot.position_m[:2], 0.035)}
    )
    filled = there.model_copy(update={"places": (scene.place("slot_0"), tight)})
    assert [p.id for p in seen_places(task, filled)] == ["slot_0"]


def test_the_report_misses_its_bar_when_one_scene_in_ten_fails(task: Task) -> None:
    counts = Counter(battery=2, slot=12)
    good = SceneScore("000000", counts, counts, counts, (0.001, 0.001), ())
    bad = SceneScore(
        "000001", Counter(slot=12), counts, counts, (np.inf, 0.001), ("battery_0 gone",)
    )
    assert report(task, [good] * 10)[1]
    lines, reached = report(task, [good] * 9 + [bad])
    assert not reached
    assert "9 of 10 scenes within 0.005 m" in lines[2]
    assert lines[3].strip() == "scene 000001: battery_0 gone"
