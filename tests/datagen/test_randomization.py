"""Domain randomisation: within its ranges, the same for the same scene, section by section."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from codediffuser.datagen.appearance import Looks
from codediffuser.datagen.cameras import T_world_camera
from codediffuser.datagen.props import HAND_REACH_M, occupied_rectangles
from codediffuser.datagen.randomization import (
    Randomization,
    draw_appearance,
    load_randomization,
    presets,
)
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import ConfigError, NotRegisteredError
from codediffuser.schema import parse_model

Draw = Callable[..., Looks]


@pytest.fixture
def carry(make_carry: Callable[..., Trajectory]) -> Trajectory:
    return make_carry(num_steps=40)


@pytest.fixture
def draw(pack_battery: PackBattery, small_scene: SceneSpec, carry: Trajectory) -> Draw:
    def looks(ranges: Randomization, index: int = 0) -> Looks:
        seed = small_scene.seed.model_copy(update={"index": index})
        scene = small_scene.model_copy(update={"seed": seed})
        return draw_appearance(ranges, "test", pack_battery, scene, carry).looks

    return looks


def inside(value: object, low: object, high: object) -> bool:
    array = np.asarray(value)
    return bool(np.all(array >= np.asarray(low)) and np.all(array <= np.asarray(high)))


@pytest.mark.parametrize("preset", presets())
def test_presets_draw_within_their_ranges(preset: str, draw: Draw) -> None:
    ranges = load_randomization(preset)
    for index in range(30):
        looks = draw(ranges, index)
        assert ranges.lights and ranges.cameras and ranges.table and ranges.sensor
        assert looks.lights and looks.sensor
        low, high = ranges.lights.count
        assert low <= len(looks.lights.directional) <= high
        assert all(light.direction[2] < 0 for light in looks.lights.directional)
        total = sum(max(light.color_rgb) for light in looks.lights.directional)
        assert total <= ranges.lights.brightness[1] + 1e-9
        assert inside(looks.table_rgb, ranges.table.low_rgb, ranges.table.high_rgb)
        assert set(looks.cameras) == {
            "left_bottom", "right_bottom", "left_top", "right_top", "direct_up"
        }  # fmt: skip
        for offset in looks.cameras.values():
            assert np.abs(offset.position_m).max() <= ranges.cameras.position_m
            assert np.abs(offset.rotation_rad).max() <= ranges.cameras.rotation_rad
        assert inside(looks.sensor.drop_probability, *ranges.sensor.drop_probability)
        assert inside(looks.sensor.color_gain, *ranges.sensor.color_gain)


def test_a_scene_draws_the_same_looks_each_time_and_another_scene_others(draw: Draw) -> None:
    ranges = load_randomization("strong")
    assert draw(ranges, 3) == draw(ranges, 3) != draw(ranges, 4)


def test_leaving_out_a_section_changes_no_other(draw: Draw) -> None:
    ranges = load_randomization("strong")
    without = draw(ranges.model_copy(update={"lights": None, "props": None}))
    assert without == draw(ranges).model_copy(update={"lights": None, "props": ()})


def test_nothing_asked_is_the_usual_look(draw: Draw) -> None:
    assert draw(Randomization()) == Looks()


def test_props_keep_clear_of_all_that_stands_or_moves(
    draw: Draw, pack_battery: PackBattery, small_scene: SceneSpec, carry: Trajectory
) -> None:
    ranges = load_randomization("strong")
    assert ranges.props is not None
    taken = occupied_rectangles(pack_battery, small_scene, carry)
    count = 0
    for index in range(40):
        for prop in draw(ranges, index).props:
            count += 1
            spot = np.array(prop.position_m[:2])
            away = np.maximum(taken[:, :2] - spot, spot - taken[:, 2:]).clip(min=0)
            radius = np.hypot(prop.size_m[0], prop.size_m[1]) / 2
            assert np.linalg.norm(away, axis=1).min() >= radius + ranges.props.clearance_m
            assert prop.position_m[2] == pytest.approx(prop.size_m[2] / 2)
    assert count > 40


def test_the_hand_and_every_object_count_as_occupied(
    pack_battery: PackBattery, small_scene: SceneSpec, carry: Trajectory
) -> None:
    taken = occupied_rectangles(pack_battery, small_scene, carry)
    for xy in (carry.hand_position_m[20, :2], small_scene.object("crate").position_m[:2]):
        assert np.any(np.all((taken[:, :2] <= xy) & (taken[:, 2:] >= xy), axis=1))
    hand = carry.hand_position_m[0, :2]
    assert taken[:, 0].min() <= hand[0] - HAND_REACH_M


def test_moved_cameras_are_off_by_exactly_what_is_recorded(
    draw: Draw, pack_battery: PackBattery
) -> None:
    looks = draw(load_randomization("strong"))
    config = pack_battery.config.cameras
    for view, moved in zip(config.views, looks.move_cameras(config).views, strict=True):
        before, after = T_world_camera(view), T_world_camera(moved)
        offset = looks.cameras[view.name]
        np.testing.assert_allclose(after[:3, 3] - before[:3, 3], offset.position_m, atol=1e-12)
        turn = after[:3, :3] @ before[:3, :3].T
        angle = np.arccos((np.trace(turn) - 1) / 2)
        assert angle == pytest.approx(np.linalg.norm(offset.rotation_rad), abs=1e-6)


def test_cameras_without_offset_stay(pack_battery: PackBattery) -> None:
    config = pack_battery.config.cameras
    assert Looks().move_cameras(config) == config


def test_an_unknown_preset_names_the_closest() -> None:
    with pytest.raises((ConfigError, NotRegisteredError), match=r"'strnog'.*strong"):
        load_randomization("strnog")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lights": {"count": [1, 4], "ambient": [0, 1], "brightness": [0, 1],
                     "elevation_rad": [0, 1], "tint": 0}}, "all that the shader counts"),
        ({"sensor": {"color_noise": [5, 1]}}, "expected .low, high. with low <= high"),
        ({"cameras": {"position_m": -1, "rotation_rad": 0}}, "cameras.position_m"),
        ({"camera": {}}, "unknown key 'camera'; did you mean 'cameras'"),
    ],
)  # fmt: skip
def test_impossible_ranges_are_refused_by_key(change: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_model(Randomization, change, "own.yaml")
