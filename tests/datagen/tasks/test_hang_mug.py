"""hang_mug: what is drawn, how it is judged, how failures are called, what the expert does."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from codediffuser.datagen.drawing import HANDLE, Disc, Line, Text
from codediffuser.datagen.mug_check import branches_in_handle
from codediffuser.datagen.mug_hanging import FINGER_REACH_M, R_WORLD_HAND_DOWN, HangingPlan
from codediffuser.datagen.mug_shapes import MugShape, passes_handle
from codediffuser.datagen.mug_tree import tree_branches, tree_of
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import Move, SceneView
from codediffuser.datagen.tasks.hang_mug import HangMug, HangMugConfig
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import ConfigError, PlacementError
from codediffuser.poses import make_transform, matrix_to_quat_wxyz, rotation_z

MakeView = Callable[..., SceneView]
Moves = Callable[[SceneSpec, int], list[Move]]

HAND_AWAY = make_transform(R_WORLD_HAND_DOWN, np.array([0.0, -0.2, 0.30]))
PHASES = [
    "approach", "descend", "grasp", "lift", "carry", "transport", "align", "insert", "lower",
    "release", "retreat", "home", "settle",
]  # fmt: skip


@pytest.fixture
def hand_away() -> np.ndarray:
    return HAND_AWAY


@pytest.fixture(scope="module")
def task() -> HangMug:
    return HangMug()


@pytest.fixture(scope="module")
def scene(task: HangMug) -> SceneSpec:
    return sample_scene(task, root_seed=0, index=0)


def hung(scene: SceneSpec, mug: str, branch: str) -> np.ndarray:
    """Pose of a mug whose handle hangs on a branch, its body below."""
    line = tree_branches(tree_of(scene))[branch]
    shape = MugShape.of(scene.object(mug).shape)
    along = np.arctan2(line.direction[1], line.direction[0])
    # The handle points up, and the branch runs along the mug's y.
    R = np.column_stack(
        [(0.0, 0.0, 1.0), (np.cos(along), np.sin(along), 0.0), (-np.sin(along), np.cos(along), 0.0)]
    )
    return HangingPlan(line, shape, R).T_world_mug(0.07)


@pytest.fixture
def solved(scene: SceneSpec, make_view: MakeView) -> MakeView:
    """The target mug hangs on the target branch; the arguments change that."""

    def make(
        offset_m: tuple[float, float, float] = (0, 0, 0), branch: str | None = None, **state: object
    ) -> SceneView:
        pose = hung(scene, scene.target.pick, branch or scene.target.place)
        pose[:3, 3] += offset_m
        return make_view(scene, {scene.target.pick: pose}, **state)

    return make


@pytest.mark.parametrize(
    ("variant", "colors", "turn_rad", "branches"),
    [
        ("sim", {"red", "white", "blue", "green"}, np.deg2rad(20), 4),
        ("real", {"red", "blue", "green"}, np.deg2rad(30), 3),
    ],
)
def test_layouts_follow_the_paper(
    task: HangMug, variant: str, colors: set[str], turn_rad: float, branches: int
) -> None:
    rng = np.random.default_rng(0)
    turns, seen = [], set()
    for _ in range(200):
        layout = task.sample_layout(rng, variant=variant)
        mugs = layout.pickable
        assert len(mugs) == 2 and mugs[0].name != mugs[1].name
        assert len(layout.free_places) == branches
        for mug in mugs:
            x_axis = mug.T_world_object[:2, 0]
            turns.append(np.arctan2(x_axis[1], x_axis[0]) - np.pi / 2)
            seen.add(mug.name.removesuffix(" mug"))
            assert mug.position_m[2] == pytest.approx(mug.shape["height_m"] / 2)
        gap = np.subtract(mugs[0].position_m, mugs[1].position_m)[:2]
        assert np.linalg.norm(gap) >= task.config.variants[variant].min_distance_m
        (pad,) = task.pads(variant)
        for mug in mugs:
            assert np.all(np.array(mug.position_m[:2]) > pad.low_m)
            assert np.all(np.array(mug.position_m[:2]) < pad.high_m)
    assert seen == colors
    assert 0.9 * turn_rad < np.abs(turns).max() <= turn_rad


def test_either_mug_may_stand_on_either_side(task: HangMug) -> None:
    rng = np.random.default_rng(0)
    first_is_left = {
        layout.objects[0].position_m[0] < layout.objects[1].position_m[0]
        for layout in (task.sample_layout(rng) for _ in range(20))
    }
    assert first_is_left == {True, False}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"picks": 1}, r"picks: mugs: expected 2, got 1"),
        ({"places": 3}, r"places: branches: expected 4, got 3"),
        ({"variant": "reel"}, r"Unknown variant 'reel'\. Did you mean 'real'\?"),
    ],
)
def test_what_a_variant_fixes_cannot_be_asked_otherwise(
    task: HangMug, arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        task.sample_layout(np.random.default_rng(0), **arguments)  # type: ignore[arg-type]


def test_too_large_a_distance_names_its_remedy(task: HangMug) -> None:
    sim = task.config.variants["sim"].model_copy(update={"min_distance_m": 1.0, "max_tries": 20})
    crowded = HangMug(task.config.model_copy(update={"variants": {"sim": sim}}))
    with pytest.raises(PlacementError, match=r"in 20 tries; lower 'variants\.sim\.min_distance_m'"):
        crowded.sample_layout(np.random.default_rng(0))


def test_unknown_colors_are_refused(task: HangMug) -> None:
    raw = task.config.model_dump(by_alias=True)
    raw["variants"]["real"]["colors"] = ["red", "bleu"]
    with pytest.raises(ConfigError, match=r"variants\.real\.colors: Unknown color 'bleu'"):
        HangMugConfig.parse(raw, "hang_mug.yaml")


def test_a_mug_that_hangs_is_success(task: HangMug, scene: SceneSpec, solved: MakeView) -> None:
    check = task.check_success(solved(), [(scene.target.pick, scene.target.place)])
    assert check.success and check.reason == ""
    assert len(check.conditions) == 7


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"offset_m": (0, 0, -0.06)}, "around_branch"),
        ({"offset_m": (0, 0, 0.10)}, "below_branch_m, around_branch"),
        ({"offset_m": (0.09, 0, 0)}, "dx_m"),
        ({"speed": (0.05, 0.0)}, "speed_mps"),
        ({"speed": (0.0, 1.0)}, "spin_radps"),
    ],
)
def test_each_condition_prevents_success(
    task: HangMug, scene: SceneSpec, solved: MakeView, change: dict[str, object],
    reason: str,
) -> None:  # fmt: skip
    check = task.check_success(solved(**change), [(scene.target.pick, scene.target.place)])
    assert not check.success
    assert reason in check.reason


def test_a_mug_that_stands_beside_the_trunk_below_the_branch_is_no_success(
    task: HangMug, scene: SceneSpec, make_view: MakeView
) -> None:
    # The supplement's two criteria alone would let it pass.
    pick, place = scene.target.pick, scene.target.place
    branch = tree_branches(tree_of(scene))[place].at(0.07)
    beside = make_transform(np.eye(3), branch - np.array([0.0, 0.08, 0.05]))
    check = task.check_success(make_view(scene, {pick: beside}), [(pick, place)])
    held = {c.name: c.holds for c in check.conditions}
    assert held["dx_m"] and held["below_branch_m"]
    assert check.reason == "around_branch"


def test_a_mug_that_is_still_held_is_no_success(
    task: HangMug, scene: SceneSpec, solved: MakeView
) -> None:
    pairs = [(scene.target.pick, scene.target.place)]
    at = hung(scene, *pairs[0])[:3, 3] + (0.0, -0.05, FINGER_REACH_M)
    holding = make_transform(R_WORLD_HAND_DOWN, at)
    assert task.check_success(solved(hand=holding, opening_m=0.02), pairs).reason == (
        "released_opening_m"
    )
    # A closed hand that has gone away holds nothing.
    assert task.check_success(solved(opening_m=0.0), pairs).success


def test_every_other_branch_is_the_wrong_one(
    task: HangMug, scene: SceneSpec, solved: MakeView
) -> None:
    pick, place = scene.target.pick, scene.target.place
    for other in (p.id for p in scene.places if p.id != place):
        view = solved(branch=other)
        assert branches_in_handle(view, pick) == [other]
        assert "around_branch" in task.check_success(view, [(pick, place)]).reason
        assert task.check_success(view, [(pick, place), (pick, other)]).pair == (pick, other)
    assert not task.check_success(solved(), []).success


def trajectory_of(views: list[Any]) -> Trajectory:
    """Moments as views of one scene show them, that of the reset first."""
    scene = views[0].scene
    ids = tuple(o.id for o in scene.objects if not o.fixed)
    poses = np.array([[view.T_world_object(i) for i in ids] for view in views])
    hands = np.array([view.hand for view in views])
    return Trajectory(
        object_ids=ids,
        object_position_m=poses[..., :3, 3],
        object_quat_wxyz=matrix_to_quat_wxyz(poses[..., :3, :3]),
        object_velocity=np.zeros((len(views), len(ids), 6)),
        qpos=np.array([[v.opening_m] * 9 for v in views]),
        qvel=np.zeros((len(views), 9)),
        hand_position_m=hands[:, :3, 3],
        hand_quat_wxyz=matrix_to_quat_wxyz(hands[:, :3, :3]),
        actions=np.zeros((len(views) - 1, 10), dtype=np.float32),
    )


def test_failures_are_named_by_phase(task: HangMug, scene: SceneSpec, make_view: MakeView) -> None:
    pick, place = scene.target.pick, scene.target.place
    other = next(o.id for o in scene.pickable if o.id != pick)
    wrong = next(p.id for p in scene.places if p.id != place)
    hanging, fallen = hung(scene, pick, place), make_transform(np.eye(3), np.array([0, 0, 0.045]))
    lying = fallen.copy()
    lying[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    in_air = make_transform(np.eye(3), np.array([0.0, -0.15, 0.30]))
    past = hanging.copy()
    past[:3, 3] += (0.0, -0.08, 0.0)

    def hand_at(T_world_mug: np.ndarray) -> np.ndarray:
        return make_transform(R_WORLD_HAND_DOWN, T_world_mug[:3, 3] + (0, 0, FINGER_REACH_M))

    def moved(*poses: np.ndarray, mug: str = pick, **state: object) -> list[SceneView]:
        after = [make_view(scene, {mug: pose}, **state) for pose in poses]
        return [make_view(scene), *after]

    cases = {
        "grasp:missed": moved(),
        "grasp:tipped": moved(lying),
        "grasp:wrong_object": moved(in_air, mug=other),
        "transport:timeout": moved(in_air, hand=hand_at(in_air), opening_m=0.03 - 0.01),
        "transport:dropped": moved(in_air, fallen),
        "insert:missed_branch": moved(in_air, past, fallen),
        "place:wrong_branch": moved(in_air, hung(scene, pick, wrong)),
        "release:not_released": moved(in_air, hanging, hand=hand_at(hanging), opening_m=0.02),
        "release:fell_off": moved(in_air, hanging, fallen),
        "release:not_at_rest": moved(in_air, hanging),
    }
    called = {
        name: task.failure_phase(scene, trajectory_of(views), [(pick, place)])
        for name, views in cases.items()
    }
    assert called == {name: name for name in cases}


@pytest.fixture
def moves_of(task: HangMug, make_view: Callable[..., Any]) -> Moves:
    """The script's moves in a scene with a seed; the hand is where it grasped from then on."""

    def play(scene: SceneSpec, seed: int) -> list[Move]:
        view = make_view(scene)
        moves = []
        for move in task.script(view, np.random.default_rng(seed)):
            moves.append(move)
            if move.phase == "grasp":
                view.hand = move.T_world_hand
        return moves

    return play


def test_the_script_goes_through_its_phases_in_time(
    task: HangMug, scene: SceneSpec, moves_of: Moves
) -> None:
    for seed in range(20):
        moves = moves_of(scene, seed)
        assert [move.phase for move in moves] == PHASES
        assert sum(move.steps for move in moves) < 0.9 * task.config.max_steps


def test_fingers_close_on_the_sides_beside_the_handle(task: HangMug, moves_of: Moves) -> None:
    for index in range(10):
        scene = sample_scene(task, root_seed=2, index=index)
        grasp = next(m for m in moves_of(scene, index) if m.phase == "grasp")
        T = scene.object(scene.target.pick).T_world_object
        assert abs(grasp.T_world_hand[:3, 1] @ T[:3, 0]) < 0.3
        assert np.linalg.norm(grasp.T_world_hand[:2, 3] - T[:2, 3]) < 0.005
        tips = grasp.T_world_hand[2, 3] - FINGER_REACH_M
        assert 0.02 < T[2, 3] + scene.object(scene.target.pick).shape["height_m"] / 2 - tips < 0.045


def test_the_handle_is_led_over_the_branch_from_its_tip(task: HangMug, moves_of: Moves) -> None:
    for index in range(12):
        scene = sample_scene(task, root_seed=3, index=index)
        pick, place = scene.target.pick, scene.target.place
        shape = MugShape.of(scene.object(pick).shape)
        branch = tree_branches(tree_of(scene))[place]
        moves = {m.phase: m.T_world_hand for m in moves_of(scene, index)}
        held = np.linalg.inv(moves["grasp"]) @ scene.object(pick).T_world_object

        ends = branch.at(0.0), branch.at(branch.length_m)
        around = {
            phase: passes_handle(shape, moves[phase] @ held, *ends)
            for phase in ("align", "insert", "lower")
        }
        assert around == {"align": False, "insert": True, "lower": True}


def test_a_mug_is_carried_sideways_in_front_of_the_tree(task: HangMug, moves_of: Moves) -> None:
    for index in range(12):
        scene = sample_scene(task, root_seed=3, index=index, variant="real")
        moves = moves_of(scene, index)
        lift, carry, transport = (
            next(m for m in moves if m.phase == phase) for phase in ("lift", "carry", "transport")
        )
        assert carry.T_world_hand[1, 3] == lift.T_world_hand[1, 3]
        assert carry.T_world_hand[0, 3] == pytest.approx(transport.T_world_hand[0, 3])
        way = abs(carry.T_world_hand[0, 3] - lift.T_world_hand[0, 3])
        assert carry.steps <= 1 + 1.2 * task.config.script.steps.carry * way / 0.1


@pytest.mark.parametrize("sunk_rad", [0.0, 0.3])
def test_a_mug_that_sank_in_the_hand_does_not_lean_the_hand_more(
    task: HangMug, make_view: Callable[..., Any], sunk_rad: float
) -> None:
    scene = next(
        s
        for s in (sample_scene(task, root_seed=4, index=i) for i in range(20))
        if s.target.place.startswith("left")
    )
    view = make_view(scene)
    for move in task.script(view, np.random.default_rng(0)):
        if move.phase == "grasp":
            view.hand = move.T_world_hand
        if move.phase == "lift":  # The handle sinks, about the line between the fingers.
            sunk = scene.object(scene.target.pick).T_world_object
            sunk[:3, :3] = sunk[:3, :3] @ Rotation.from_euler("y", sunk_rad).as_matrix()
            view.poses[scene.target.pick] = sunk
        if move.phase == "insert":
            lean = np.arccos(-move.T_world_hand[2, 2])
            assert lean <= task.config.script.tilt_rad[1] + 0.01


def test_no_two_demonstrations_are_one_motion(scene: SceneSpec, moves_of: Moves) -> None:
    one, same, other = (moves_of(scene, seed) for seed in (0, 0, 1))
    for a, b, c in zip(one, same, other, strict=True):
        np.testing.assert_array_equal(a.T_world_hand, b.T_world_hand)
        if a.phase not in ("home", "settle"):
            assert not np.allclose(a.T_world_hand, c.T_world_hand)
    assert [m.steps for m in one] != [m.steps for m in other]


def test_the_picture_shows_colors_handles_and_the_branch(task: HangMug, scene: SceneSpec) -> None:
    shapes = task.draw_reset(scene).shapes
    lines = [s for s in shapes if isinstance(s, Line) and s.color == HANDLE]
    for mug, line in zip(scene.pickable, lines, strict=True):
        towards = np.subtract(line.end_m, line.start_m)
        handle = mug.T_world_object[:2, 0]
        assert line.start_m == pytest.approx(mug.position_m[:2])
        np.testing.assert_allclose(towards / np.linalg.norm(towards), handle, atol=1e-9)
    middles = {o.position_m[:2] for o in scene.pickable}
    discs = [s for s in shapes if isinstance(s, Disc) and s.center_m in middles]
    assert len({disc.fill for disc in discs}) == 2
    name = scene.target.place.replace("_", "-")
    written = [s.at_m for s in shapes if isinstance(s, Text) and s.text == name]
    target = scene.object(scene.target.pick)
    assert min(np.linalg.norm(np.subtract(at, target.position_m[:2])) for at in written) < 0.03


@pytest.mark.sim
@pytest.mark.parametrize("place", ["right_topmost", "left_topmost", "right_middle", "left_middle"])
def test_the_expert_hangs_a_mug_by_contact_alone(task: HangMug, place: str) -> None:
    from codediffuser.datagen.envs import physics_env
    from codediffuser.datagen.script import run_expert

    scene = next(
        s
        for s in (sample_scene(task, root_seed=11, index=i) for i in range(60))
        if s.target.place == place
    )
    env = physics_env(task, scene)
    run = run_expert(env, scene, np.random.default_rng(0))
    assert run.success, run.failure_reason
    hold = run.trajectory.actions[-1]
    for _ in range(100):
        env.control_step(hold)
    assert env.check().success
    assert env.view.object_speed(scene.target.pick)[0] < 1e-3
    # The other mug was left alone.
    other = next(o for o in scene.pickable if o.id != scene.target.pick)
    moved = env.view.T_world_object(other.id)[:3, 3] - other.T_world_object[:3, 3]
    assert np.linalg.norm(moved) < 0.005


@pytest.mark.sim
def test_a_mug_without_a_branch_in_its_handle_falls(task: HangMug, scene: SceneSpec) -> None:
    from codediffuser.datagen.envs import physics_env

    pick, place = scene.target.pick, scene.target.place
    pose = hung(scene, pick, place)
    pose[:3, 3] += (0.0, 0.0, 0.15)
    w, x, y, z = matrix_to_quat_wxyz(pose[:3, :3] @ rotation_z(0.0))
    lifted = scene.object(pick).model_copy(
        update={"position_m": tuple(pose[:3, 3]), "quat_wxyz": (w, x, y, z)}
    )
    objects = tuple(lifted if o.id == pick else o for o in scene.objects)
    env = physics_env(task, scene.model_copy(update={"objects": objects}))
    env.reset()
    for _ in range(50):
        env.control_step(np.array([0, 0, 0.3, 0, 1, 0, 1, 0, 0, 0.04], dtype=np.float32))
    assert env.view.T_world_object(pick)[2, 3] < 0.1
    assert not env.check().success
