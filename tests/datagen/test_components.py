from collections.abc import Callable

import pytest

from codediffuser.datagen.instructions.components import clear_maximum
from codediffuser.datagen.layout import Layout
from codediffuser.datagen.task_config import Observer
from codediffuser.datagen.tasks.pack_battery import PackBattery

Make = Callable[..., Layout]

# One battery at each end of the table: left, right, front (towards the robot), back.
CROSS = [(-0.08, 0.0), (0.06, 0.0), (-0.01, -0.08), (-0.01, 0.03)]


@pytest.mark.parametrize(
    ("words", "battery"),
    [
        ("left-most battery", "battery_0"),
        ("right-most battery", "battery_1"),
        ("front-most battery", "battery_2"),
        ("back-most battery", "battery_3"),
    ],
)
def test_directions_are_those_of_an_observer_at_the_robot(
    pack_battery: PackBattery, make_layout: Make, words: str, battery: str
) -> None:
    assert pack_battery.components()[words].extract(make_layout(CROSS)) == (battery,)


def test_a_lone_battery_is_every_extreme(pack_battery: PackBattery, make_layout: Make) -> None:
    scene = make_layout([(0.0, 0.0)])
    for phrase in pack_battery.components().values():
        if phrase.category == "battery":
            assert phrase.extract(scene) == ("battery_0",)


def test_extremes_within_the_margin_name_nothing(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    left, front = (pack_battery.components()[f"{w}-most battery"] for w in ("left", "front"))
    scene = make_layout([(-0.050, -0.08), (-0.045, 0.03)])  # 5 mm apart in x, 110 mm in y.
    assert not left.check(scene)
    assert front.extract(scene) == ("battery_0",)


def test_packed_batteries_are_never_the_extreme(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    scene = make_layout([(0.0, 0.0), (0.0, -0.09)], free=[5])  # All but one slot are taken.
    assert pack_battery.components()["back-most battery"].extract(scene) == ("battery_0",)


@pytest.mark.parametrize(
    ("words", "slots"),
    [
        ("slot on the back-most row", [0, 1, 2, 3]),
        ("slot on the middle row", [4, 5, 6, 7]),
        ("slot on the front-most row", [8, 9, 10, 11]),
        ("slot on the right column", [0, 4, 8]),
        ("slot on the middle columns", [1, 2, 5, 6, 9, 10]),
        ("slot on left column", [3, 7, 11]),
    ],
)
def test_rows_and_columns_are_those_of_the_crate_and_name_their_free_slots(
    pack_battery: PackBattery, make_layout: Make, words: str, slots: list[int]
) -> None:
    phrase = pack_battery.components()[words]
    every = make_layout([(0.0, 0.0)])
    assert phrase.extract(every) == tuple(f"slot_{i:02d}" for i in slots)
    some = make_layout([(0.0, 0.0)], free=[slots[-1], *(i for i in range(12) if i not in slots)])
    assert phrase.extract(some) == (f"slot_{slots[-1]:02d}",)
    none = make_layout([(0.0, 0.0)], free=[i for i in range(12) if i not in slots])
    assert not phrase.check(none)


def test_nearest_and_furthest_slot_depend_on_the_battery(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    nearest, furthest = (pack_battery.components()[f"{w} slot"] for w in ("nearest", "furthest"))
    scene = make_layout([(-0.08, 0.0), (0.06, 0.0)])
    assert nearest.extract(scene, "battery_0") == ("slot_11",)
    assert nearest.extract(scene, "battery_1") == ("slot_08",)
    assert furthest.extract(scene, "battery_0") == ("slot_00",)
    assert furthest.extract(scene, "battery_1") == ("slot_03",)
    assert nearest.extract(scene) == ("slot_08", "slot_11")


def test_slots_at_nearly_the_same_distance_are_not_told_apart(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    nearest, furthest = (pack_battery.components()[f"{w} slot"] for w in ("nearest", "furthest"))
    middle = make_layout([(-0.01, 0.0)])  # On the crate's line of symmetry.
    assert not nearest.check(middle)
    assert not furthest.check(middle)


def test_the_only_free_slot_is_nearest_and_furthest(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    scene = make_layout([(-0.01, 0.0)], free=[6])
    for word in ("nearest", "furthest"):
        phrase = pack_battery.components()[f"{word} slot"]
        assert phrase.extract(scene, "battery_0") == ("slot_06",)


def test_an_observer_of_the_public_release_calls_far_front(make_layout: Make) -> None:
    config = PackBattery.load_config()
    turned = config.model_copy(update={"observer": Observer(right=(1, 0), front=(0, 1))})
    task = PackBattery(turned)
    scene = make_layout(CROSS)
    assert task.components()["front-most battery"].extract(scene) == ("battery_3",)
    assert task.components()["left-most battery"].extract(scene) == ("battery_0",)
    rows = task.components()["slot on the front-most row"].extract(scene)
    assert rows == ("slot_00", "slot_01", "slot_02", "slot_03")


def test_an_observer_needs_square_unit_directions() -> None:
    with pytest.raises(ValueError, match="right angle"):
        Observer(right=(1, 0), front=(1, 0))
    with pytest.raises(ValueError, match="length 1"):
        Observer(right=(2, 0), front=(0, 1))


def test_clear_maximum_needs_its_margin() -> None:
    assert clear_maximum({}, 0.1) == ()
    assert clear_maximum({"a": 1.0}, 0.1) == ("a",)
    assert clear_maximum({"a": 1.0, "b": 1.2}, 0.1) == ("b",)
    assert clear_maximum({"a": 1.0, "b": 1.05}, 0.1) == ()
