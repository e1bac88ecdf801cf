from collections.abc import Callable

import numpy as np
import pytest

from codediffuser.datagen.crate import crate_slots
from codediffuser.datagen.packing_script import R_WORLD_HAND_DOWN
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import SceneView
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.poses import make_transform, matrix_to_quat_wxyz, rotation_z

HAND_AWAY = make_transform(R_WORLD_HAND_DOWN, np.array([0.0, 0.0, 0.30]))
TILTED = np.array([[1, 0, 0], [0, np.cos(0.5), -np.sin(0.5)], [0, np.sin(0.5), np.cos(0.5)]])


@pytest.fixture
def hand_away() -> np.ndarray:
    return HAND_AWAY


@pytest.fixture(scope="module")
def scene(pack_battery: PackBattery) -> SceneSpec:
    return sample_scene(pack_battery, root_seed=0, index=0, picks=2, places=6)


@pytest.fixture
def solved(scene: SceneSpec, make_view: Callable[..., SceneView]) -> Callable[..., SceneView]:
    """The target battery stands in the target slot; the arguments change that."""

    def make(
        offset_m: tuple[float, float, float] = (0, 0, 0),
        R: np.ndarray | None = None,
        **state: object,
    ) -> SceneView:
        at = np.array(scene.place(scene.target.place).position_m) + offset_m
        pose = make_transform(rotation_z(1.0) if R is None else R, at)
        return make_view(scene, {scene.target.pick: pose}, **state)

    return make


def test_slots_lie_where_the_release_has_them(pack_battery: PackBattery) -> None:
    slots = crate_slots(pack_battery.config.crate)
    xy = np.array([slot.position_m[:2] for slot in slots])
    np.testing.assert_allclose(xy[0], (0.053, 0.222), atol=1e-9)
    np.testing.assert_allclose(xy[3], (-0.073, 0.222), atol=1e-9)
    np.testing.assert_allclose(xy[8], (0.053, 0.138), atol=1e-9)
    assert [slot.id for slot in slots] == [f"slot_{i:02d}" for i in range(12)]


def test_slot_regions_are_cells_that_do_not_overlap(pack_battery: PackBattery) -> None:
    crate = pack_battery.config.crate
    for slot in crate_slots(crate):
        assert slot.size_m == (0.042, 0.042, 0.053)
        assert slot.center_m[:2] == slot.position_m[:2]
        assert slot.center_m[2] - slot.size_m[2] / 2 == pytest.approx(crate.position_m[2])


def test_layouts_follow_the_ranges(pack_battery: PackBattery, scenes: list[SceneSpec]) -> None:
    crate = pack_battery.config.crate
    colors = pack_battery.config.battery.colors
    for scene in scenes:
        waiting = [o for o in scene.objects if o.category == "battery" and o.place is None]
        packed = [o for o in scene.objects if o.place is not None]
        ids = [o.id for o in scene.objects]
        assert ids == [*(f"battery_{i}" for i in range(len(waiting) + len(packed))), "crate"]
        assert [o.id for o in waiting] == ids[: len(waiting)]
        assert 1 <= len(waiting) <= 4
        assert 0 <= len(packed) <= 11
        for battery in waiting:
            x, y, z = battery.position_m
            assert -0.09 <= x <= 0.07 and -0.09 <= y <= 0.03 and z == 0
        for battery in packed:
            assert battery.position_m == scene.place(battery.place or "").position_m
            assert battery.position_m[2] == crate.floor_m
        assert {o.name.removesuffix(" battery") for o in waiting + packed} <= set(colors)
        assert scene.object("crate").fixed


def test_waiting_batteries_keep_their_distance(scenes: list[SceneSpec]) -> None:
    for scene in scenes:
        xy = np.array([o.position_m[:2] for o in scene.pickable])
        gaps = np.linalg.norm(xy[:, None] - xy[None], axis=-1) + np.eye(len(xy))
        assert gaps.min() >= 0.09


def test_batteries_stand_upright_at_any_yaw(scenes: list[SceneSpec]) -> None:
    poses = np.array([o.T_world_object for s in scenes for o in s.objects if not o.fixed])
    np.testing.assert_allclose(poses[:, 2, 2], 1.0)
    yaws = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    assert yaws.min() < -2.8 and yaws.max() > 2.8


def test_every_color_is_drawn(pack_battery: PackBattery, scenes: list[SceneSpec]) -> None:
    names = {o.name for s in scenes for o in s.objects if o.category == "battery"}
    assert names == {f"{color} battery" for color in pack_battery.config.battery.colors}


def test_a_battery_fits_a_cell_and_the_crate_its_extents(
    pack_battery: PackBattery, scene: SceneSpec
) -> None:
    crate, battery = pack_battery.config.crate, pack_battery.config.battery
    body = pack_battery.geometry(scene.object("battery_0"))
    assert body.collision[0].extents[0] < crate.pitch_m - crate.wall_m
    assert body.collision[0].bounds[0, 2] == pytest.approx(0)
    assert body.collision[0].bounds[1, 2] == pytest.approx(battery.height_m)
    shell = pack_battery.geometry(scene.object("crate"))
    np.testing.assert_allclose(shell.visual.extents, crate.size_m, atol=1e-9)
    # Floor, five walls across x and four across y.
    assert len(shell.collision) == 10


def test_packed_batteries_are_lighter(pack_battery: PackBattery, scene: SceneSpec) -> None:
    waiting = pack_battery.geometry(scene.object("battery_0"))
    packed = pack_battery.geometry(next(o for o in scene.objects if o.place))
    assert (waiting.density_kgm3, packed.density_kgm3) == (5000, 1000)


def test_the_script_takes_185_steps_through_the_named_phases(
    pack_battery: PackBattery, scene: SceneSpec, make_view: Callable[..., SceneView]
) -> None:
    moves = list(pack_battery.script(make_view(scene), np.random.default_rng(0)))
    assert sum(move.steps for move in moves) == 185
    phases = list(dict.fromkeys(move.phase for move in moves))
    assert phases == [
        "approach", "descend", "grasp", "lift", "transport", "lower", "release", "retreat", "home",
    ]  # fmt: skip
    grasp = next(move for move in moves if move.phase == "grasp")
    np.testing.assert_allclose(
        grasp.T_world_hand[:2, 3], scene.object(scene.target.pick).position_m[:2]
    )
    release = next(move for move in moves if move.phase == "release")
    np.testing.assert_allclose(
        release.T_world_hand[:2, 3], scene.place(scene.target.place).position_m[:2]
    )


def test_a_battery_that_stands_in_the_slot_is_success(
    pack_battery: PackBattery, scene: SceneSpec, solved: Callable[..., SceneView]
) -> None:
    check = pack_battery.check_success(solved(), scene.instruction.pairs)
    assert check.success and check.reason == ""
    assert check.pair == (scene.target.pick, scene.target.place)
    assert len(check.conditions) == 6


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"offset_m": (0.031, 0, 0)}, "xy_distance_m"),
        ({"offset_m": (0, 0, 0.006)}, "base_height_m"),
        ({"R": TILTED}, "upright"),
        ({"speed": (0.05, 0.0)}, "speed_mps"),
        ({"speed": (0.0, 1.0)}, "spin_radps"),
    ],
)
def test_each_condition_alone_prevents_success(
    pack_battery: PackBattery, scene: SceneSpec, solved: Callable[..., SceneView],
    change: dict[str, object], reason: str,
) -> None:  # fmt: skip
    pairs = [(scene.target.pick, scene.target.place)]
    check = pack_battery.check_success(solved(**change), pairs)
    assert not check.success
    assert check.reason == reason


def test_a_battery_that_is_still_held_is_no_success(
    pack_battery: PackBattery, scene: SceneSpec, solved: Callable[..., SceneView]
) -> None:
    pairs = [(scene.target.pick, scene.target.place)]
    at = np.add(scene.place(scene.target.place).position_m, (0, 0, 0.11))
    holding = make_transform(R_WORLD_HAND_DOWN, at)
    check = pack_battery.check_success(solved(hand=holding, opening_m=0.015), pairs)
    assert check.reason == "released_opening_m"
    # A closed hand that has gone away holds nothing.
    assert pack_battery.check_success(solved(opening_m=0.0), pairs).success


def test_any_pair_of_the_instruction_will_do_but_no_other(
    pack_battery: PackBattery, scene: SceneSpec, solved: Callable[..., SceneView]
) -> None:
    wanted = (scene.target.pick, scene.target.place)
    other = next(o.id for o in scene.pickable if o.id != scene.target.pick)
    pairs = [(other, scene.target.place), wanted]
    assert pack_battery.check_success(solved(), pairs).pair == wanted
    assert not pack_battery.check_success(solved(), pairs[:1]).success
    assert not pack_battery.check_success(solved(), []).success


def trajectory_to(
    scene: SceneSpec, ends: dict[str, np.ndarray], *, lifted: str | None,
    hand: np.ndarray = HAND_AWAY, opening_m: float = 0.04,
) -> Trajectory:  # fmt: skip
    """Three moments: reset, something in the air, and the end poses."""
    ids = tuple(o.id for o in scene.objects if not o.fixed)
    start = np.array([scene.object(i).T_world_object for i in ids])
    middle = start.copy()
    if lifted is not None:
        middle[ids.index(lifted), 2, 3] += 0.2
    end = start.copy()
    for name, pose in ends.items():
        end[ids.index(name)] = pose
    poses = np.stack([start, middle, end])
    qpos = np.full((3, 9), opening_m)
    return Trajectory(
        object_ids=ids,
        object_position_m=poses[..., :3, 3],
        object_quat_wxyz=matrix_to_quat_wxyz(poses[..., :3, :3]),
        object_velocity=np.zeros((3, len(ids), 6)),
        qpos=qpos,
        qvel=np.zeros((3, 9)),
        hand_position_m=np.repeat(hand[None, :3, 3], 3, axis=0),
        hand_quat_wxyz=np.repeat(matrix_to_quat_wxyz(hand[:3, :3])[None], 3, axis=0),
        actions=np.zeros((2, 10), dtype=np.float32),
    )


def phase_of(task: PackBattery, scene: SceneSpec, trajectory: Trajectory) -> str:
    return task.failure_phase(scene, trajectory, [(scene.target.pick, scene.target.place)])


def test_failures_are_named_by_phase(pack_battery: PackBattery, scene: SceneSpec) -> None:
    pick = scene.target.pick
    other = next(o.id for o in scene.pickable if o.id != pick)
    slot = np.array(scene.place(scene.target.place).position_m)
    wrong = next(p for p in scene.free_places if p.id != scene.target.place)

    def at(x: float, y: float, z: float, R: np.ndarray | None = None) -> np.ndarray:
        return make_transform(np.eye(3) if R is None else R, np.array([x, y, z]))

    fallen = at(0, 0, 0.01, np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]))
    in_air = at(0.0, 0.0, 0.17)
    cases = {
        "grasp:missed": trajectory_to(scene, {}, lifted=None),
        "grasp:tipped": trajectory_to(scene, {pick: fallen}, lifted=None),
        "grasp:wrong_object": trajectory_to(scene, {}, lifted=other),
        "transport:dropped": trajectory_to(scene, {pick: at(-0.1, -0.1, 0.0)}, lifted=pick),
        "transport:timeout": trajectory_to(
            scene, {pick: in_air}, lifted=pick, hand=at(0, 0, 0.28), opening_m=0.015
        ),
        "place:on_rim": trajectory_to(scene, {pick: at(slot[0], slot[1], 0.05)}, lifted=pick),
        "place:wrong_slot": trajectory_to(scene, {pick: at(*wrong.position_m)}, lifted=pick),
        "release:not_at_rest": trajectory_to(scene, {pick: at(*slot)}, lifted=pick),
        "release:not_released": trajectory_to(
            scene, {pick: at(*slot)}, lifted=pick, hand=at(slot[0], slot[1], 0.115),
            opening_m=0.015,
        ),
    }  # fmt: skip
    assert {name: phase_of(pack_battery, scene, run) for name, run in cases.items()} == {
        name: name for name in cases
    }
