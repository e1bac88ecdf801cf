from __future__ import annotations

import numpy as np
import pytest

from codediffuser.datagen.task import get_task
from codediffuser.errors import LabelError
from codediffuser.labeling.perception.finding import FoundInstance
from codediffuser.labeling.perception.instances import Arrangement, arrange, selectable
from codediffuser.labeling.perception.logged import instance_at


def block(
    category: str, x: float, y: float = 0.0, size: tuple[float, float, float] = (0.03, 0.03, 0.06),
    rgb: tuple[int, int, int] = (40, 120, 50),
) -> FoundInstance:  # fmt: skip
    """A block of points standing on the table at (x, y)."""
    unit = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 7)] * 3), axis=-1).reshape(-1, 3)
    points = unit * size + np.array([x, y, size[2] / 2])
    colors = np.tile(np.array(rgb, np.uint8), (len(points), 1))
    return FoundInstance(category, points.astype(np.float32), colors, points.mean(axis=0), 0.9)


CELL = (0.042, 0.042, 0.053)


def test_an_object_in_a_place_takes_it_and_does_not_wait() -> None:
    batteries = [block("battery", -0.1), block("battery", 0.1)]
    slots = [block("slot", 0.1, size=CELL), block("slot", 0.142, size=CELL)]
    arranged = arrange(batteries, slots)
    assert arranged.waiting == (0,)
    assert arranged.taken_by == {0: 1}


def test_what_stands_against_something_put_away_is_put_away_too() -> None:
    # A row of books: the free slot is beside the first only.
    books = [block("book", 0.03 * k) for k in range(4)] + [block("book", 0.3)]
    arranged = arrange(books, [block("slot", -0.03)])
    assert arranged.waiting == (4,)
    assert arranged.taken_by == {}


def test_in_a_row_where_all_touch_what_stands_before_it_waits() -> None:
    row = get_task("stow_book").row
    assert row is not None
    y = row.shelf.spine_y_m + row.depth_m / 2
    size = (0.024, row.depth_m, 0.19)
    books = [block("book", 0.024 * k, y, size) for k in range(4)] + [block("book", 0.1, 0.0, size)]
    gaps = [block("slot", 0.11, y, size)]
    assert arrange(books, gaps, row) == Arrangement((4,), {})
    # By nearness, the waiting book would be taken for put away: its corner is near to the gap.
    near = block("book", 0.11, y - row.depth_m - 0.005, size)
    assert arrange([*books[:4], near], gaps).waiting == ()
    assert arrange([*books[:4], near], gaps, row).waiting == (4,)


def test_without_places_everything_waits() -> None:
    assert arrange([block("mug", 0.0), block("mug", 0.2)], []).waiting == (0, 1)


def test_nothing_found_leaves_nothing_to_choose() -> None:
    assert selectable((), get_task("pack_battery")) == ()


def test_choices_say_what_they_are_and_who_stands_there() -> None:
    found = (
        block("battery", -0.1),
        block("battery", 0.1, rgb=(100, 60, 140)),
        block("slot", 0.1, size=CELL),
    )
    waiting, slot = selectable(found, get_task("pack_battery"))
    assert (waiting.name, waiting.role, waiting.follows) == ("green battery", "pick", waiting.id)
    assert (slot.role, slot.taken_by, slot.follows) == ("place", "purple battery", None)


def test_the_instance_at_a_logged_place_is_found() -> None:
    slots = [block("slot", 0.0), block("slot", 0.042)]
    assert instance_at(slots, "slot", np.array([0.04, 0.0, 0.03]), "place") is slots[1]


def test_a_neighbour_is_never_taken_for_a_missing_instance() -> None:
    slots = [block("slot", 0.0), block("battery", 0.042)]
    with pytest.raises(LabelError, match=r"found 0 of 1, the nearest is 0\.042 m away"):
        instance_at(slots, "slot", np.array([0.042, 0.0, 0.03]), "scene 000001, place 'slot_3'")


def test_two_instances_at_one_place_are_an_error() -> None:
    twice = [block("slot", 0.0), block("slot", 0.004)]
    with pytest.raises(LabelError, match="found 2 of 2"):
        instance_at(twice, "slot", np.array([0.0, 0.0, 0.03]), "place")
