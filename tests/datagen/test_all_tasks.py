"""Contracts that every registered task keeps; a new task is tested by being in the folder."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen.instructions.generator import check_instruction, check_library
from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.datagen.overlap import OverlapChecker
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import TASKS, Move, Task
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import ConfigError
from codediffuser.poses import apply_transform, make_transform

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.script import ExpertRun

SCENES = 20
VARIANTS = ("sim", "real")
HAND_RESTS = make_transform(
    np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, -0.2, 0.4])
)


@pytest.fixture(scope="module", params=TASKS.names())
def task(request: pytest.FixtureRequest) -> Task:
    return TASKS.get(request.param)()


@pytest.fixture(scope="module", params=VARIANTS)
def variant(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def drawn(task: Task, variant: str) -> list[SceneSpec]:
    return [sample_scene(task, root_seed=1, index=i, variant=variant) for i in range(SCENES)]


def test_the_yaml_names_its_task_and_reads_strictly(task: Task) -> None:
    assert task.config_path().exists()
    assert task.config.task == task.name
    assert len({view.name for view in task.config.cameras.views}) == len(task.config.cameras.views)


def test_every_phrase_of_the_library_is_known(task: Task) -> None:
    check_library(task, load_templates(task.name))


def test_same_seed_gives_the_same_scene(task: Task, variant: str, drawn: list[SceneSpec]) -> None:
    for index in range(0, SCENES, 5):
        assert sample_scene(task, root_seed=1, index=index, variant=variant) == drawn[index]


def test_scenes_differ(drawn: list[SceneSpec]) -> None:
    assert len({repr(scene.objects) for scene in drawn}) == SCENES


def test_an_unknown_variant_is_named(task: Task) -> None:
    rng = np.random.default_rng(0)
    for ask in (lambda: task.sample_layout(rng, variant="reel"), lambda: task.pads("reel")):
        with pytest.raises(ConfigError, match=r"Unknown variant 'reel'\. Did you mean 'real'\?"):
            ask()


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


def test_geometry_depends_on_what_the_object_stores_alone(
    task: Task, drawn: list[SceneSpec]
) -> None:
    for obj in drawn[0].objects:
        moved = obj.model_copy(update={"id": "elsewhere", "position_m": (1.0, 2.0, 3.0)})
        here, there = task.geometry(obj), task.geometry(moved)
        np.testing.assert_array_equal(here.visual.vertices, there.visual.vertices)
        assert len(here.collision) == len(there.collision)


def test_nothing_runs_into_anything_at_the_start(task: Task, drawn: list[SceneSpec]) -> None:
    checker = OverlapChecker(task)
    for scene in drawn:
        assert list(checker.overlaps(scene)) == [], scene.scene_id
        assert checker.below_table(scene) == [], scene.scene_id


def test_what_moves_starts_inside_the_workspace(task: Task, drawn: list[SceneSpec]) -> None:
    low, high = np.array(task.config.workspace.low_m), np.array(task.config.workspace.high_m)
    for scene in drawn:
        for xy in (o.position_m[:2] for o in scene.pickable):
            assert np.all((xy > low[:2]) & (xy < high[:2]))


def test_places_lie_inside_the_workspace(task: Task, drawn: list[SceneSpec]) -> None:
    low, high = np.array(task.config.workspace.low_m), np.array(task.config.workspace.high_m)
    for scene in drawn:
        for place in scene.places:
            assert np.all(np.array(place.size_m) > 0)
            assert np.all((np.array(place.center_m) > low) & (np.array(place.center_m) < high))


def test_what_waits_stands_on_a_pad(task: Task, variant: str, drawn: list[SceneSpec]) -> None:
    pads = task.pads(variant)
    assert len({pad.name for pad in pads}) == len(pads)
    for pad in pads:
        assert len(pad.crosses_m()) >= 4
    for scene in drawn:
        for xy in (np.array(o.position_m[:2]) for o in scene.pickable):
            assert any(np.all((xy >= pad.low_m) & (xy <= pad.high_m)) for pad in pads)


def test_a_reset_picture_can_be_drawn(task: Task, drawn: list[SceneSpec]) -> None:
    for scene in drawn:
        picture = task.draw_reset(scene)
        assert picture.shapes
        assert picture.sentence == scene.instruction.text


class Resting:
    """A scene as it was reset to, the hand in the air: what a script sees when nothing moves."""

    def __init__(self, scene: SceneSpec) -> None:
        self.scene = scene

    def T_world_object(self, object_id: str) -> np.ndarray:
        return self.scene.object(object_id).T_world_object

    def object_speed(self, object_id: str) -> tuple[float, float]:
        return 0.0, 0.0

    def T_world_hand(self) -> np.ndarray:
        return HAND_RESTS

    def gripper_opening_m(self) -> float:
        return 0.04


def moves_of(task: Task, scene: SceneSpec, seed: int) -> list[Move]:
    return list(task.script(Resting(scene), np.random.default_rng(seed)))


def test_scripts_are_moves_of_named_phases_in_time(task: Task) -> None:
    for index in range(5):
        scene = sample_scene(task, root_seed=1, index=index)
        moves = moves_of(task, scene, index)
        assert sum(move.steps for move in moves) < task.config.max_steps
        assert set(task.push_phases) <= {move.phase for move in moves}
        for move in moves:
            R = move.T_world_hand[:3, :3]
            assert move.phase and move.steps >= 1 and 0 <= move.gripper_m <= 0.04
            np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-6)


def test_scripts_follow_their_generator(task: Task) -> None:
    scene = sample_scene(task, root_seed=1, index=0)
    one, same, other = (moves_of(task, scene, seed) for seed in (0, 0, 1))
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a.T_world_hand, b.T_world_hand)
        assert a.steps == b.steps
    pairs = zip(one, other, strict=True)
    assert any(not np.allclose(a.T_world_hand, c.T_world_hand) for a, c in pairs)


def test_nothing_done_is_no_success(task: Task, drawn: list[SceneSpec]) -> None:
    for scene in drawn:
        check = task.check_success(Resting(scene), scene.instruction.pairs)
        assert not check.success
        assert check.pair in scene.instruction.pairs
        names = [condition.name for condition in check.conditions]
        assert len(set(names)) == len(names)
        assert set(check.reason.split(", ")) <= set(names)
    assert not task.check_success(Resting(drawn[0]), []).success


@pytest.fixture(scope="module")
def env(task: Task) -> Iterator[SceneEnv]:
    from codediffuser.datagen.envs import physics_env

    env = physics_env(task, sample_scene(task, root_seed=1, index=0))
    yield env
    env.close()


@pytest.fixture(scope="module")
def runs(task: Task, env: SceneEnv) -> list[ExpertRun]:
    """Demonstrations of two scenes, and of the first one again."""
    from codediffuser.datagen.script import run_expert

    scenes = [sample_scene(task, root_seed=1, index=i) for i in (0, 1, 0)]
    return [run_expert(env, scene, np.random.default_rng(7)) for scene in scenes]


@pytest.mark.sim
def test_the_expert_succeeds(runs: list[ExpertRun]) -> None:
    assert [run.failure_reason for run in runs] == ["", "", ""]


@pytest.mark.sim
def test_the_same_scene_and_generator_give_the_same_bits(runs: list[ExpertRun]) -> None:
    one, _, again = (run.trajectory for run in runs)
    for name in ("object_position_m", "object_quat_wxyz", "qpos", "actions"):
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))


@pytest.mark.sim
def test_bodies_are_at_rest_before_the_first_action(runs: list[ExpertRun]) -> None:
    for run in runs:
        start = run.trajectory.object_position_m[0]
        movable = [o for o in run.scene.objects if not o.fixed]
        drawn_at = np.array([o.position_m for o in movable])
        assert np.abs(start - drawn_at).max() < 0.01
        assert np.abs(run.trajectory.object_velocity[0, :, :3]).max() < 0.02


@pytest.mark.sim
def test_only_the_target_is_carried_off(runs: list[ExpertRun]) -> None:
    for run in runs:
        moved = np.linalg.norm(np.ptp(run.trajectory.object_position_m[:, :, :2], axis=0), axis=-1)
        ids = run.trajectory.object_ids
        assert ids[int(np.argmax(moved))] == run.scene.target.pick


@pytest.mark.sim
def test_a_demonstration_that_stops_early_failed_in_a_named_phase(
    task: Task, runs: list[ExpertRun]
) -> None:
    whole = runs[0].trajectory
    for share in (0.05, 0.4, 0.6):
        steps = round(share * whole.num_steps)
        cut = Trajectory(
            object_ids=whole.object_ids,
            actions=whole.actions[:steps],
            **{
                name: getattr(whole, name)[: steps + 1]
                for name in (
                    "object_position_m", "object_quat_wxyz", "object_velocity", "qpos", "qvel",
                    "hand_position_m", "hand_quat_wxyz",
                )
            },
        )  # fmt: skip
        phase, _, what = task.failure_phase(
            runs[0].scene, cut, runs[0].scene.instruction.pairs
        ).partition(":")
        assert phase and what


def test_labels_find_the_target_in_the_workspace(task: Task, drawn: list[SceneSpec]) -> None:
    # They take the points that its collision parts contain; the workspace leaves out the table.
    scene = drawn[0]
    pick = scene.object(scene.target.pick)
    parts = task.geometry(pick).collision
    assert parts, "a target without collision parts cannot be labelled"
    surface = np.concatenate([part.triangles_center for part in parts])
    world = apply_transform(pick.T_world_object, surface)
    box = task.config.workspace
    inside = np.all((world > np.array(box.low_m)) & (world < np.array(box.high_m)), axis=1)
    assert inside.mean() > 0.5
