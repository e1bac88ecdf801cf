"""Rows of books: leaning ones rest exactly, the row fills the shelf, slots lie where they open."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codediffuser.datagen.book_row import (
    Standing,
    draw_row,
    face_x_m,
    lean_for_room,
    leaning_pose,
)
from codediffuser.datagen.book_slots import row_places
from codediffuser.datagen.tasks.stow_book import StowBook
from codediffuser.errors import ConfigError, PlacementError
from codediffuser.poses import apply_transform

FLOOR_M, Y_M = 0.012, 0.215


@pytest.fixture(scope="module")
def task() -> StowBook:
    return StowBook()


def draw(task: StowBook, seed: int, slots: int | None = None, **changes: object) -> list[Standing]:
    row = task.config.variants["sim"].row.model_copy(update=changes)
    return list(
        draw_row(
            np.random.default_rng(seed), row, task.config.books, floor_m=FLOOR_M, y_m=Y_M,
            new_thickness_m=0.024, slots=slots, keys="variants.sim.row",
        )
    )  # fmt: skip


def lean_rad(book: Standing) -> float:
    return float(np.arctan2(book.T_world_book[0, 2], book.T_world_book[2, 2]))


def section(book: Standing) -> np.ndarray:
    """Corners (4, 2) in world x and z: lower left, lower right, upper right, upper left."""
    half, height = book.thickness_m / 2, book.height_m
    corners = [[-half, 0, 0], [half, 0, 0], [half, 0, height], [-half, 0, height]]
    return apply_transform(book.T_world_book, np.array(corners))[:, [0, 2]]


def gap_m(left: Standing, right: Standing) -> float:
    """Smallest free width between two neighbours at any height that both have."""
    top = min(section(left)[:, 1].max(), section(right)[:, 1].max())
    heights = np.linspace(FLOOR_M, top, 400)
    return float((right.face_x_m(-1, heights) - left.face_x_m(1, heights)).min())


@given(
    angle=st.floats(0.05, 0.5), left=st.booleans(),
    thickness=st.floats(0.015, 0.04), height=st.floats(0.12, 0.25),
)  # fmt: skip
def test_a_leaning_book_stands_on_its_lower_edge(
    angle: float, left: bool, thickness: float, height: float
) -> None:
    signed = -angle if left else angle
    T = leaning_pose(0.1, Y_M, FLOOR_M, thickness, signed)
    corners = section(Standing("X", T, thickness, height, fixed=False))
    lowest = corners[np.argmin(corners[:, 1])]
    np.testing.assert_allclose(lowest, [0.1, FLOOR_M], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.sign(T[0, 2]) == np.sign(signed)


@given(extra=st.floats(0.01, 0.08), thickness=st.floats(0.015, 0.04), height=st.floats(0.15, 0.25))
def test_a_book_leans_until_it_fills_its_room(
    extra: float, thickness: float, height: float
) -> None:
    angle = lean_for_room(extra, thickness, height)
    T = leaning_pose(0.0, Y_M, FLOOR_M, thickness, -angle)
    width = np.ptp(section(Standing("X", T, thickness, height, fixed=False))[:, 0])
    assert width == pytest.approx(thickness + extra, abs=1e-9)


def test_too_much_room_has_no_angle() -> None:
    assert np.isnan(lean_for_room(0.5, 0.02, 0.2))


def test_faces_follow_the_lean() -> None:
    T = leaning_pose(0.0, Y_M, 0.0, 0.02, -0.2)
    low, high = face_x_m(T, 0.02, 0.2, -1, np.array([0.0, 0.2 * np.cos(0.2)]))
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high == pytest.approx(-0.2 * np.sin(0.2))
    assert face_x_m(T, 0.02, 0.2, -1, 1.0) == pytest.approx(high)


@pytest.mark.parametrize("slots", [2, 3, 4])
def test_leaning_books_touch_their_support_and_nothing_overlaps(task: StowBook, slots: int) -> None:
    for seed in range(40):
        row = draw(task, seed, slots)
        leaning = [i for i, book in enumerate(row) if lean_rad(book) != 0]
        assert len(leaning) == (1 if slots == 2 else 2)
        for left, right in pairwise(row):
            assert gap_m(left, right) >= -1e-9
        for i in leaning:
            neighbour = row[i - 1] if lean_rad(row[i]) < 0 else row[i + 1]
            assert lean_rad(neighbour) == 0
            assert neighbour.height_m > section(row[i])[:, 1].max() - FLOOR_M - row[i].thickness_m
            pair = (neighbour, row[i]) if lean_rad(row[i]) < 0 else (row[i], neighbour)
            assert gap_m(*pair) == pytest.approx(0, abs=1e-9)


def test_a_leaning_book_cannot_fall_back(task: StowBook) -> None:
    for seed in range(40):
        for book in draw(task, seed):
            if angle := lean_rad(book):
                middle = book.T_world_book @ [0, 0, book.height_m / 2, 1]
                lowest = section(book)[np.argmin(section(book)[:, 1]), 0]
                assert np.sign(middle[0] - lowest) == np.sign(angle)


def test_every_group_has_room_for_the_new_book(task: StowBook) -> None:
    row_config = task.config.variants["sim"].row
    for seed in range(40):
        row = draw(task, seed)
        free = row_config.row_width_m - sum(b.thickness_m for b in row if not b.fixed)
        groups = 1 if sum(lean_rad(b) != 0 for b in row) == 1 else 2
        assert free >= 0.024 * min(groups, 1) + row_config.spare_m


def test_the_row_lies_between_the_large_books(task: StowBook) -> None:
    width = task.config.variants["sim"].row.row_width_m
    for seed in range(20):
        row = draw(task, seed)
        assert [b.fixed for b in row] == [True, True, *[False] * (len(row) - 4), True, True]
        for book in row[2:-2]:
            assert np.abs(section(book)[:, 0]).max() <= width / 2 + 1e-9
        assert section(row[1])[:, 0].max() == pytest.approx(-width / 2)
        assert section(row[-2])[:, 0].min() == pytest.approx(width / 2)


@pytest.mark.parametrize("slots", [2, 3, 4])
def test_places_are_books_and_slots_from_left_to_right(task: StowBook, slots: int) -> None:
    shelf, depth = task.config.shelf, task.config.books.depth_m
    for seed in range(20):
        row = draw(task, seed, slots)
        places, taken = row_places(row, shelf, depth, 0.024)
        assert [p.id for p in places] == [f"slot_{i:02d}" for i in range(len(places))]
        assert len(places) - len(taken) == slots
        assert set(taken) == {i for i, book in enumerate(row) if not book.fixed}
        middles = [p.position_m[0] for p in places if p.id not in taken.values()]
        assert middles == sorted(middles)
        assert all(min(p.size_m) > 0 for p in places)


def test_regions_of_free_slots_share_no_point(task: StowBook) -> None:
    shelf, depth = task.config.shelf, task.config.books.depth_m
    for seed in range(40):
        row = draw(task, seed)
        places, taken = row_places(row, shelf, depth, 0.024)
        boxes = [
            (
                np.array(p.center_m) - np.array(p.size_m) / 2,
                np.array(p.center_m) + np.array(p.size_m) / 2,
            )
            for p in places
            if p.id not in taken.values()
        ]
        for i, (low, high) in enumerate(boxes):
            for other_low, other_high in boxes[i + 1 :]:
                assert np.any((low >= other_high) | (other_low >= high))


def test_same_generator_same_row(task: StowBook) -> None:
    for one, other in zip(draw(task, 3), draw(task, 3), strict=True):
        assert one.title == other.title
        np.testing.assert_array_equal(one.T_world_book, other.T_world_book)


def test_a_row_that_cannot_fit_names_what_to_change(task: StowBook) -> None:
    with pytest.raises(PlacementError, match=r"variants\.sim\.row\.row_width_m"):
        draw(task, 0, row_width_m=0.10, max_redraws=20)


@pytest.mark.parametrize("slots", [0, 1, 5])
def test_impossible_numbers_of_slots_are_refused(task: StowBook, slots: int) -> None:
    with pytest.raises(ConfigError, match=f"expected 2 to 4, got {slots}"):
        draw(task, 0, slots)
