"""Contracts that every registered task keeps; a new task is tested by being in the folder."""

from itertools import combinations

import numpy as np
import pytest

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen.instructions.generator import check_instruction, check_library
from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import TASKS, Task
from codediffuser.poses import apply_transform

SCENES_PER_TASK = 40


@pytest.fixture(scope="module", params=TASKS.names())
def task(request: pytest.FixtureRequest) -> Task:
    return TASKS.get(request.param)()


@pytest.fixture(scope="module")
def drawn(task: Task) -> list[SceneSpec]:
    return [sample_scene(task, root_seed=1, index=i) for i in range(SCENES_PER_TASK)]


def test_the_yaml_names_its_task_and_reads_strictly(task: Task) -> None:
    assert task.config_path().exists()
    assert task.config.task == task.name
    assert len({view.name for view in task.config.cameras.views}) == len(task.config.cameras.views)


def test_every_phrase_of_the_library_is_known(task: Task) -> None:
    check_library(task, load_templates(task.name))


def test_same_seed_gives_the_same_scene(task: Task, drawn: list[SceneSpec]) -> None:
    for index in range(0, SCENES_PER_TASK, 10):
        assert sample_scene(task, root_seed=1, index=index) == drawn[index]


def test_scenes_differ(drawn: list[SceneSpec]) -> None:
    assert len({repr(scene.objects) for scene in drawn}) == SCENES_PER_TASK


def test_targets_can_be_picked_and_placed(task: Task, drawn: list[SceneSpec]) -> None:
    for scene in drawn:
        pick, place = scene.target.pick, scene.target.place
        assert pick in {o.id for o in scene.pickable}
        assert place in {p.id for p in scene.free_places}
        assert scene.object(pick).category == task.pick_category
        assert scene.place(place).category == task.place_category


def test_instructions_say_what_is_stored(task: Task, drawn: list[SceneSpec]) -> None:
    for scene in drawn:
        check_instruction(scene, task)


def test_bodies_are_closed_and_their_collision_parts_convex(
    task: Task, drawn: list[SceneSpec]
) -> None:
    for obj in drawn[0].objects:
        geometry = task.geometry(obj)
        assert len(geometry.visual.vertices) > 0
        for part in geometry.collision:
            assert part.is_watertight and part.is_convex
            assert part.volume > 0


def test_nothing_that_moves_touches_another_at_the_start(
    task: Task, drawn: list[SceneSpec]
) -> None:
    for scene in drawn:
        boxes = []
        for obj in (o for o in scene.objects if not o.fixed):
            points = apply_transform(obj.T_world_object, task.geometry(obj).visual.vertices)
            boxes.append((obj.id, points.min(axis=0), points.max(axis=0)))
        for (a, low_a, high_a), (b, low_b, high_b) in combinations(boxes, 2):
            apart = np.any((low_a > high_b) | (low_b > high_a))
            assert apart, f"{a} and {b} overlap in scene {scene.scene_id}"


def test_what_moves_starts_inside_the_workspace(task: Task, drawn: list[SceneSpec]) -> None:
    low, high = np.array(task.config.workspace.low_m), np.array(task.config.workspace.high_m)
    for scene in drawn:
        for xy in (o.position_m[:2] for o in scene.pickable):
            assert np.all((xy > low[:2]) & (xy < high[:2]))


def test_a_reset_picture_can_be_drawn(task: Task, drawn: list[SceneSpec]) -> None:
    for scene in drawn:
        picture = task.draw_reset(scene)
        assert picture.shapes
        assert picture.sentence == scene.instruction.text
