from __future__ import annotations

from collections.abc import Callable

import pytest

from codediffuser.errors import ConfigError, InstructionError
from codediffuser.labeling.language.checker import check_program
from codediffuser.labeling.language.composer import compose_program
from codediffuser.labeling.language.detection import compose_detection
from codediffuser.labeling.language.grounding import ground
from codediffuser.labeling.language.instances import Directions, ListedInstances

MakeScene = Callable[..., ListedInstances]

FOUR = {
    "left": (-0.08, -0.03),
    "right": (0.06, -0.02),
    "front": (0.0, -0.08),
    "back": (-0.01, 0.02),
}
"""Waiting batteries, each the extreme on its side."""


def answer(text: str, scene: ListedInstances) -> tuple[str, str]:
    grounding = ground(text, scene)
    return grounding.target("pick"), grounding.target("place")


@pytest.mark.parametrize("side", FOUR)
def test_extreme_batteries_follow_the_axes(side: str, make_scene: MakeScene) -> None:
    scene = make_scene(FOUR, taken=[0, 5])
    assert answer(f"Put the {side}-most battery into a slot.", scene)[0] == side


@pytest.mark.parametrize("side", FOUR)
def test_an_observer_across_the_table_sees_the_opposite(side: str, make_scene: MakeScene) -> None:
    across = Directions(right=(-1.0, 0.0), front=(0.0, 1.0))
    opposite = {"left": "right", "right": "left", "front": "back", "back": "front"}
    scene = make_scene(FOUR, directions=across)
    text = f"Put the {side}-most battery into the slot on the {opposite[side]}"
    band = " row" if side in ("front", "back") else " column"
    here = answer(text + band, make_scene(FOUR, directions=Directions()))
    there = answer(
        f"Put the {opposite[side]}-most battery into the slot on the {side}{band}", scene
    )
    assert here == there


BANDS = {
    "front row": {8, 9, 10, 11},
    "middle row": {4, 5, 6, 7},
    "back row": {0, 1, 2, 3},
    "left column": {3, 7, 11},
    "middle columns": {1, 2, 5, 6, 9, 10},
    "right column": {0, 4, 8},
}


@pytest.mark.parametrize("band", BANDS)
def test_rows_and_columns_are_those_of_the_crate_not_of_the_free_slots(
    band: str, make_scene: MakeScene
) -> None:
    text = f"Put a battery into the slot on the {band}."
    for only in range(12):
        scene = make_scene(taken=[i for i in range(12) if i != only])
        if only in BANDS[band]:
            assert answer(text, scene)[1] == f"slot_{only}"
        else:
            with pytest.raises(InstructionError, match="fits nothing"):
                ground(text, scene)


def test_packed_batteries_are_never_picked(make_scene: MakeScene) -> None:
    scene = make_scene({"b": (0.0, 0.0)}, taken=[0, 3, 8, 11])
    for side in ("left", "right", "front", "back", "middle"):
        assert answer(f"Put the {side} battery into a slot.", scene)[0] == "b"


def test_nearest_and_furthest_are_measured_from_the_chosen_battery(make_scene: MakeScene) -> None:
    scene = make_scene(FOUR)
    assert answer("Put the left-most battery in the nearest slot.", scene)[1] == "slot_11"
    assert answer("Put the right-most battery in the nearest slot.", scene)[1] == "slot_8"
    assert answer("Put the left-most battery in the furthest slot.", scene)[1] == "slot_0"


def test_a_distance_may_be_measured_from_another_battery(make_scene: MakeScene) -> None:
    text = "Put the right-most battery into the slot furthest from the left-most battery."
    assert answer(text, make_scene(FOUR)) == ("right", "slot_0")


def test_the_other_one_is_not_the_one_in_use(make_scene: MakeScene) -> None:
    two = {"l": (-0.05, 0.0), "r": (0.05, 0.0)}
    for side, other in (("left", "r"), ("right", "l")):
        text = f"I need to use the {side}-most battery. Put the other one into a slot."
        assert answer(text, make_scene(two))[0] == other


def test_what_stays_is_left_out_before_choosing(make_scene: MakeScene) -> None:
    text = "Do not use the left-most battery. Put the battery furthest to the left in a slot."
    assert answer(text, make_scene(FOUR))[0] == "back"


def test_a_slot_can_be_ruled_out(make_scene: MakeScene) -> None:
    scene = make_scene({"b": (-0.073, 0.0)}, taken=range(9))
    assert answer("Put a battery in the nearest slot.", scene)[1] == "slot_11"
    text = "Put a battery in the left-most slot, but not in the nearest one."
    assert answer(text, scene)[1] == "slot_10"


def test_colours_choose_among_waiting_batteries(make_scene: MakeScene) -> None:
    names = {"a": "green battery", "b": "purple battery", "packed_0": "purple battery"}
    scene = make_scene({"a": (-0.05, 0.0), "b": (0.05, 0.0)}, taken=[0], names=names)
    assert answer("Put the purple battery into a slot.", scene)[0] == "b"
    assert answer("Put the left-most green battery into a slot.", scene)[0] == "a"


def test_corners_and_middles(make_scene: MakeScene) -> None:
    scene = make_scene(FOUR)
    assert answer("Put a battery into the back left slot.", scene)[1] == "slot_3"
    assert answer("Put a battery into the slot in the front right corner.", scene)[1] == "slot_8"
    assert answer("Put a battery in the middle of the back row.", scene)[1] in ("slot_1", "slot_2")


def test_any_takes_the_first_waiting_battery_and_free_slot(make_scene: MakeScene) -> None:
    scene = make_scene(FOUR, taken=[0, 1])
    assert answer("Put a battery into a slot.", scene) == ("left", "slot_2")


def test_the_error_says_what_was_looked_for_and_what_there_is(make_scene: MakeScene) -> None:
    scene = make_scene({}, taken=[2])
    with pytest.raises(InstructionError) as caught:
        ground("Put the left-most battery outside the crate into the nearest slot.", scene)
    message = str(caught.value)
    assert "'the leftmost battery outside the crate'" in message
    assert "1 battery (packed_2" in message and "11 slot (slot_0" in message


def test_a_colour_that_is_not_there_fits_nothing(make_scene: MakeScene) -> None:
    with pytest.raises(InstructionError, match=r"red battery.*1 battery \(b, green battery"):
        ground("Put the red battery into a slot.", make_scene())


def test_contradicting_sides_are_refused() -> None:
    with pytest.raises(InstructionError, match="cannot be left and right at once"):
        compose_program("Put the left right battery into a slot.")


def test_composed_programs_pass_the_checker() -> None:
    check_program(compose_program("Put the left-most battery into the nearest slot."))
    check_program(compose_detection("green battery", ("battery", "slot")), "detect")


def test_the_composer_keeps_to_its_task_and_axes() -> None:
    with pytest.raises(InstructionError, match="no category crate"):
        compose_program("Put a battery into a slot.", ("battery", "slot"))
    skew = Directions(right=(0.6, 0.8), front=(0.8, -0.6))
    with pytest.raises(ConfigError, match="along the world's x or y axis"):
        compose_program("Put a battery into a slot.", directions=skew)


def test_detection_programs_need_one_category() -> None:
    assert "get_obj" in compose_detection("batteries", ("battery", "slot"))
    for phrase in ("the thing", "battery slot"):
        with pytest.raises(InstructionError, match="name one category"):
            compose_detection(phrase, ("battery", "slot"))
