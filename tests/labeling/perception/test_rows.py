from __future__ import annotations

import numpy as np
import pytest

from codediffuser.datagen.book_row import Standing
from codediffuser.datagen.box_row import BoxRow
from codediffuser.datagen.task_config import ClusterConfig, RowSearchConfig
from codediffuser.datagen.tasks.stow_book import StowBook
from codediffuser.labeling.perception.clustering import NOISE
from codediffuser.labeling.perception.rows import RowFinder
from codediffuser.poses import apply_transform

SIZES = ClusterConfig(eps_m=0.012, min_share=0.25)
SEARCH = RowSearchConfig()


@pytest.fixture(scope="module")
def row() -> BoxRow:
    found = StowBook().row
    assert found is not None
    return found


@pytest.fixture(scope="module")
def finder(row: BoxRow) -> RowFinder:
    return RowFinder(row, SEARCH, SIZES)


def surface(box: Standing, depth_m: float) -> np.ndarray:
    """Readings (N, 3) float32 of front and top of a box, about 2 mm apart."""
    rng = np.random.default_rng(round(1e4 * box.thickness_m))
    front = rng.uniform(0, 1, (1200, 3)) * (1, 0, 1)
    top = rng.uniform(0, 1, (600, 3)) * (1, 1, 0) + (0, 0, 1)
    size = np.array([box.thickness_m, depth_m, box.height_m])
    points = (np.concatenate([front, top]) - (0.5, 0.5, 0.0)) * size
    return apply_transform(box.T_world_book, points).astype(np.float32)


@pytest.fixture(scope="module")
def books(row: BoxRow) -> list[Standing]:
    """Two that stand, one that leans left against them, and one that stands on the right."""
    return [
        row.box(-0.10, 0.028, 0.20, 0.0),
        row.box(-0.072, 0.024, 0.19, 0.0),
        row.box(-0.048 + 0.19 * np.sin(0.2), 0.022, 0.19, -0.2),
        row.box(0.02, 0.030, 0.22, 0.0),
    ]


@pytest.fixture(scope="module")
def cloud(row: BoxRow, books: list[Standing]) -> tuple[np.ndarray, np.ndarray]:
    """Readings of the books, and which book each shows."""
    parts = [surface(book, row.depth_m) for book in books]
    return np.concatenate(parts), np.repeat(np.arange(4), [len(p) for p in parts])


def test_boxes_come_from_left_to_right_and_stand_where_they_do(
    finder: RowFinder, books: list[Standing], cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    points, true = cloud
    shuffled = np.array([2, 0, 3, 1])[true]
    boxes = finder.boxes(points, shuffled)
    assert len(boxes) == 4
    for number, (box, book) in enumerate(zip(boxes, books, strict=True)):
        assert np.mean(true[box.shown] == number) > 0.95
        assert box.standing is not None
        z = np.array([0.02, 0.18])
        for side in (-1, 1):
            np.testing.assert_allclose(
                box.standing.face_x_m(side, z), book.face_x_m(side, z), atol=0.003
            )
        assert box.standing.height_m == pytest.approx(book.height_m, abs=0.004)


def test_a_box_in_pieces_is_one(finder: RowFinder, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    points, true = cloud
    piece = true.copy()
    piece[(true == 2) & (points[:, 2] > 0.12)] = 4
    piece[(true == 0) & (points[:, 0] < -0.09)] = 5
    whole, broken = finder.boxes(points, true), finder.boxes(points, piece)
    assert len(broken) == 4
    for a, b in zip(whole, broken, strict=True):
        assert len(np.intersect1d(a.shown, b.shown)) > 0.97 * len(a.shown)


def test_readings_that_voted_for_the_neighbour_come_back(
    finder: RowFinder, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    points, true = cloud
    piece = true.copy()
    piece[np.flatnonzero(true == 1)[::40]] = 3
    for number, box in enumerate(finder.boxes(points, piece)):
        assert np.mean(true[box.shown] == number) > 0.95


def test_a_crumb_is_no_box(finder: RowFinder, cloud: tuple[np.ndarray, np.ndarray]) -> None:
    points, true = cloud
    crumb = points[:40] + np.array([0.2, 0.0, 0.0], np.float32)
    boxes = finder.boxes(np.concatenate([points, crumb]), np.append(true, [4] * 40))
    assert len(boxes) == 4


def test_a_box_before_the_row_waits_and_is_one(
    row: BoxRow, finder: RowFinder, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    points, true = cloud
    waiting = surface(row.box(0.0, 0.024, 0.16, 0.0), row.depth_m)
    waiting += np.array([0.12, -0.215, 0.0], np.float32)
    halves = np.where(waiting[:, 2] > 0.08, 4, 5)
    *in_row, other = finder.boxes(np.concatenate([points, waiting]), np.append(true, halves))
    assert len(in_row) == 4
    assert other.standing is None
    assert len(other.shown) == len(waiting)


def test_gaps_lie_beside_the_box_that_leans(
    row: BoxRow, finder: RowFinder, books: list[Standing], cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    points, true = cloud
    x, y = np.meshgrid(np.arange(-0.12, 0.06, 0.002), np.arange(0.11, 0.28, 0.002))
    floor = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.012)]).astype(np.float32)
    wall = np.column_stack([x.ravel(), np.full(x.size, 0.281), y.ravel()]).astype(np.float32)
    everything = np.concatenate([points, floor, wall])
    boxes = finder.boxes(points, true)
    gaps = finder.gaps(everything, boxes, 20)
    assert [gap.beside for gap in gaps] == [(1, 2), (2, 3)]
    for gap in gaps:
        left, right = (books[i] for i in gap.beside)
        low, high = row.gap_region(left, right)
        np.testing.assert_allclose(gap.middle_world, (low + high) / 2, atol=0.003)
        assert (gap.shown >= len(points)).mean() > 0.9, "gaps hold what belongs to no book"


def test_a_gap_that_shows_nothing_is_dropped(
    finder: RowFinder, cloud: tuple[np.ndarray, np.ndarray]
) -> None:
    points, true = cloud
    boxes = finder.boxes(points, true)
    assert finder.gaps(np.zeros((0, 3), np.float32), boxes, 20) == ()


def test_nothing_seen_is_nothing_found(finder: RowFinder) -> None:
    nothing = np.zeros((0, 3), np.float32)
    assert finder.boxes(nothing, np.zeros(0, np.int64)) == ()
    few = np.zeros((3, 3), np.float32)
    assert finder.boxes(few, np.full(3, NOISE)) == ()
    assert finder.gaps(few, (), 20) == ()
