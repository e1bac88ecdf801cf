from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from codediffuser.datagen.box_row import BoxRow
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.datagen.tasks.stow_book import StowBook

FLOOR_M, SPINES_M = 0.012, 0.15


@pytest.fixture(scope="module")
def task() -> StowBook:
    return StowBook()


@pytest.fixture(scope="module")
def row(task: StowBook) -> BoxRow:
    assert task.row is not None
    return task.row


def test_only_the_task_with_a_shelf_has_a_row() -> None:
    assert get_task("stow_book").row is not None
    assert get_task("hang_mug").row is None
    assert get_task("pack_battery").row is None


def test_thickness_is_that_of_the_catalogue(row: BoxRow) -> None:
    assert row.thickness_m == (0.020, 0.034)
    # What joining pieces by their size rests on: two boxes never look like one.
    assert 2 * row.thickness_m[0] > row.thickness_m[1] + 0.004


@pytest.mark.parametrize("index", range(5))
def test_gaps_between_true_books_are_the_scene_s_slots(task: StowBook, index: int) -> None:
    scene = sample_scene(task, root_seed=3, index=index)
    row = task.row
    assert row is not None
    books = [
        row.box(edge_x(o.T_world_object, o.shape["thickness_m"]), o.shape["thickness_m"],
                o.shape["height_m"], lean(o.T_world_object))
        for o in scene.objects if o.category == "book" and o not in scene.pickable
    ]  # fmt: skip
    books.sort(key=lambda b: b.T_world_book[0, 3] + 0.1 * b.T_world_book[0, 2])
    wide = [row.gap_region(a, b) for a, b in pairwise(books) if row.gap_width_m(a, b) > 0.012]
    assert len(wide) == len(scene.free_places)
    for (low, high), place in zip(wide, scene.free_places, strict=True):
        np.testing.assert_allclose((low + high) / 2, place.center_m, atol=1e-6)
        np.testing.assert_allclose(high - low, place.size_m, atol=1e-6)


def test_boxes_that_stand_against_each_other_leave_no_room(row: BoxRow) -> None:
    left, right = row.box(0.0, 0.024, 0.19, 0.0), row.box(0.024, 0.03, 0.2, 0.0)
    assert row.gap_width_m(left, right) == pytest.approx(0.0, abs=1e-9)


def test_a_box_that_leans_leaves_room_at_one_end(row: BoxRow) -> None:
    left, leans = row.box(0.0, 0.024, 0.19, 0.0), row.box(0.07, 0.024, 0.19, -0.2)
    assert row.gap_width_m(left, leans) == pytest.approx(0.046, abs=1e-6)
    low, high = row.gap_region(left, leans)
    assert low[2] < FLOOR_M < high[2] < FLOOR_M + 0.19 / 2


@pytest.mark.parametrize(
    ("front_y_m", "inside"), [(SPINES_M, True), (SPINES_M - 0.02, True), (-0.065, False)]
)
def test_what_stands_before_the_row_waits(row: BoxRow, front_y_m: float, inside: bool) -> None:
    y = np.linspace(front_y_m, front_y_m + row.depth_m, 50)
    points = np.column_stack([np.zeros(50), y, np.full(50, 0.1)])
    assert row.holds(points) is inside


def edge_x(T_world_book: np.ndarray, thickness_m: float) -> float:
    side = 1.0 if lean(T_world_book) > 0 else -1.0
    return float(T_world_book[0, 3] + T_world_book[0, 0] * side * thickness_m / 2)


def lean(T_world_book: np.ndarray) -> float:
    return float(np.arctan2(T_world_book[0, 2], T_world_book[2, 2]))
