"""Batches: one fixed set of bodies serves scenes of different sizes, and none of them notices."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from codediffuser.datagen.batching import (
    SceneBatch,
    body_kind,
    common_slots,
    moment_of,
    pad_scene,
    stack_moments,
)
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.script import run_expert
from codediffuser.datagen.sim import TABLE_CENTER_M, TABLE_HALF_SIZE_M
from codediffuser.datagen.task import TASKS, get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import ConfigError, ShapeError


@pytest.mark.parametrize("task", TASKS.names())
def test_slots_are_as_few_as_hold_every_scene(task: str) -> None:
    scenes = [sample_scene(get_task(task), root_seed=1, index=i) for i in range(6)]
    slots = common_slots(scenes)
    most = Counter(slots.kinds)
    for scene, taken in zip(scenes, slots.slot_of, strict=True):
        assert len(set(taken.values())) == len(scene.objects)
        assert all(slots.kinds[taken[o.id]] == body_kind(o) for o in scene.objects)
    for kind, count in most.items():
        assert count == max(sum(body_kind(o) == kind for o in s.objects) for s in scenes)


@pytest.mark.parametrize("task", TASKS.names())
def test_padded_scenes_have_equal_bodies_and_park_far_from_the_table(task: str) -> None:
    scenes = [sample_scene(get_task(task), root_seed=1, index=i) for i in range(4)]
    slots = common_slots(scenes)
    padded = [pad_scene(get_task(task), s, slots, i) for i, s in enumerate(scenes)]
    shapes = [[(o.category, o.shape, o.fixed) for o in scene.objects] for scene in padded]
    assert all(s == shapes[0] for s in shapes)
    edge = TABLE_CENTER_M[0] + TABLE_HALF_SIZE_M[0]
    parked = [o for s in padded for o in s.objects if o.id.startswith("parked")]
    assert parked and all(o.position_m[0] > edge + 1.0 for o in parked)
    spots = [o.position_m for o in padded[0].objects if o.id.startswith("parked")]
    assert len(set(spots)) == len(spots)


def test_scenes_of_two_tasks_make_no_batch(scenes: list[SceneSpec]) -> None:
    other = scenes[1].model_copy(update={"task": "stow_book"})
    with pytest.raises(ConfigError, match="a batch needs scenes of one task"):
        common_slots([scenes[0], other])


@pytest.fixture(scope="module")
def batch(pack_battery: PackBattery, scenes: list[SceneSpec]) -> SceneBatch:
    return SceneBatch(pack_battery, scenes[:2])


def test_a_batch_solves_its_scenes_step_by_step_together(
    batch: SceneBatch, scenes: list[SceneSpec], pack_battery: PackBattery
) -> None:
    from codediffuser.datagen.envs import physics_env

    env = physics_env(pack_battery, scenes[0])
    runs = [run_expert(env, s, np.random.default_rng(i)) for i, s in enumerate(scenes[:2])]
    state = batch.reset()
    assert not any(check.success for check in batch.checks())
    for actions in zip(*(run.trajectory.actions for run in runs), strict=True):
        state = batch.step(np.stack(actions))
    assert [check.success for check in batch.checks()] == [True, True]
    for row, run in enumerate(runs):
        alone = run.trajectory.object_position_m[-1]
        together = moment_of(state, batch.slots, scenes[row], row).object_position_m
        np.testing.assert_allclose(together, alone, atol=2e-3)


def test_parked_bodies_stay_where_they_are(batch: SceneBatch) -> None:
    first = batch.reset()
    action = np.concatenate([first.hand_position_m, np.zeros((2, 7))], axis=1)
    action[:, 3:9] = [0, 1, 0, 1, 0, 0]
    for _ in range(25):
        last = batch.step(action.astype(np.float32))
    parked = ~first.present
    assert parked.any()
    moved = np.linalg.norm(last.position_m - first.position_m, axis=-1)
    assert moved[parked].max() < 2e-3


def test_one_action_per_scene_is_asked_for(batch: SceneBatch) -> None:
    with pytest.raises(ShapeError, match=r"expected shape \(2, 10\), got \(3, 10\)"):
        batch.step(np.zeros((3, 10), dtype=np.float32))


def test_states_of_other_scenes_do_not_fit(batch: SceneBatch, scenes: list[SceneSpec]) -> None:
    state = batch.reset()
    lonely = moment_of(state, batch.slots, scenes[0], 0)
    with pytest.raises(ShapeError, match="expected states of"):
        stack_moments(batch.padded[:1], [lonely])
