"""Bodies: mass, friction and shape as the task says; what a view tells is what there is."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

import numpy as np
import pytest

from codediffuser.datagen.known_shapes import KEPT, Shapes
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.datagen.views import (
    MomentView,
    TrajectoryView,
    join_moments,
    moment_at,
    state_row,
)

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.script import ExpertRun


@pytest.fixture
def env(physics: SceneEnv, scenes: list[SceneSpec]) -> SceneEnv:
    physics.reset(options={"scene": scenes[0]})
    return physics


def test_every_convex_part_collides(env: SceneEnv, pack_battery: PackBattery) -> None:
    # ManiSkill's own builder drops a part that cannot be cooked, without a word.
    for obj in env.scene_spec.objects:
        shapes = env.scene.actors[obj.id]._bodies[0].collision_shapes
        assert len(shapes) == len(pack_battery.geometry(obj).collision)


def test_bodies_weigh_what_their_shape_and_density_say(
    env: SceneEnv, pack_battery: PackBattery
) -> None:
    for obj in env.scene_spec.objects:
        if obj.fixed:
            continue
        geometry = pack_battery.geometry(obj)
        expected = sum(part.volume for part in geometry.collision) * geometry.density_kgm3
        mass = env.scene.actors[obj.id]._bodies[0].mass
        # PhysX cooks a hull of fewer vertices, a little inside the exact one.
        assert mass == pytest.approx(expected, rel=0.03)


def test_objects_rest_where_the_scene_puts_them(env: SceneEnv) -> None:
    for obj in env.scene_spec.objects:
        if obj.fixed:
            continue
        T = env.view.T_world_object(obj.id)
        np.testing.assert_allclose(T[:3, 3], obj.position_m, atol=2e-3)
        assert T[2, 2] > 0.9999
        assert max(env.view.object_speed(obj.id)) < 0.02


def test_view_lists_the_movable_objects_in_scene_order(env: SceneEnv) -> None:
    assert env.view.object_ids == tuple(o.id for o in env.scene_spec.objects if not o.fixed)


def test_shapes_are_computed_once_per_kind(
    pack_battery: PackBattery, scenes: list[SceneSpec]
) -> None:
    shapes = Shapes(pack_battery)
    scene = next(s for s in scenes if len(s.pickable) > 1)
    first, second = scene.pickable[:2]
    assert shapes.of(first) is shapes.of(second)
    packed = next(o for s in scenes for o in s.objects if o.place is not None)
    assert shapes.of(packed).density_kgm3 != shapes.of(first).density_kgm3


def test_shapes_that_are_never_the_same_do_not_pile_up() -> None:
    rng, task = np.random.default_rng(0), get_task("hang_mug")
    shapes, made = Shapes(task), []
    for _ in range(2 * KEPT):
        mug = task.sample_layout(rng).pickable[0]
        made.append(weakref.ref(shapes.of(mug).visual))
        assert shapes.of(mug) is shapes.of(mug)
    # Besides those that are kept, the last few are known to whoever makes meshes of mugs.
    assert sum(mesh() is not None for mesh in made) <= KEPT + 16


def test_simulator_and_stored_moment_show_the_same(env: SceneEnv) -> None:
    live, stored = env.view, MomentView(env.scene_spec, env.view.object_ids, env.view.moment())
    target = env.scene_spec.target.pick
    np.testing.assert_array_equal(live.T_world_object(target), stored.T_world_object(target))
    np.testing.assert_array_equal(live.T_world_hand(), stored.T_world_hand())
    assert live.object_speed(target) == stored.object_speed(target)
    assert live.gripper_opening_m() == stored.gripper_opening_m()


def test_last_moment_of_a_trajectory_is_judged_like_the_simulator(
    expert_run: ExpertRun, pack_battery: PackBattery
) -> None:
    view = TrajectoryView(expert_run.scene, expert_run.trajectory)
    assert pack_battery.check_success(view, expert_run.scene.instruction.pairs) == expert_run.check


def test_moments_join_to_the_trajectory_they_came_from(expert_run: ExpertRun) -> None:
    whole = expert_run.trajectory
    moments = [moment_at(whole, i) for i in range(whole.num_steps + 1)]
    joined = join_moments(whole.object_ids, moments, list(whole.actions))
    np.testing.assert_array_equal(joined.qpos, whole.qpos)
    np.testing.assert_array_equal(joined.object_velocity, whole.object_velocity)
    np.testing.assert_array_equal(joined.actions, whole.actions)


def test_a_single_moment_joins_to_a_trajectory_of_no_steps(env: SceneEnv) -> None:
    still = join_moments(env.view.object_ids, [env.view.moment()], [])
    assert still.num_steps == 0 and still.actions.shape == (0, 10)


def test_state_row_is_laid_out_like_an_action(env: SceneEnv) -> None:
    row = state_row(env.view.moment())
    T = env.view.T_world_hand()
    np.testing.assert_allclose(row[:3], T[:3, 3], atol=1e-6)
    np.testing.assert_allclose(row[3:6], T[:3, 0], atol=1e-6)
    np.testing.assert_allclose(row[6:9], T[:3, 1], atol=1e-6)
    assert row[9] == pytest.approx(0.04, abs=1e-4)
