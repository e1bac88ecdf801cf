"""A row of books on a shelf: which stand, which lean, and the slots that leaning books open.

A leaning book rests with a lower edge on the floor and with an upper edge against a standing
neighbour; that pose is computed exactly, so that nothing moves when a scene begins. Left of it and
right of it there is a slot: closed at the top on the side that it leans to, open on the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from codediffuser.datagen.bookshelf import BooksConfig
from codediffuser.datagen.layout import drawn_count
from codediffuser.datagen.ranges import CountRange, Range
from codediffuser.errors import PlacementError
from codediffuser.poses import make_transform
from codediffuser.schema import Strict

PATTERNS: dict[int, tuple[int, ...]] = {2: (1,), 3: (2,), 4: (1, 1)}
"""Number of slots to the sizes of the groups of leaning books that open them: two books in one
group lean away from each other and share the slot between them."""


class RowConfig(Strict):
    """Ranges that rows are drawn from."""

    side_books: tuple[tuple[str, ...], tuple[str, ...]]
    """Titles of the large books that never move, at the left end and at the right end."""
    shelf_books: tuple[str, ...]
    """Titles of the books that may stand between them."""
    count: CountRange
    """How many of these do."""
    slots: CountRange = Field(default=(2, 4))
    """How many slots leaning books open: 2 by one, 3 or 4 by two of them."""
    row_width_m: float
    """Between the large books of the two ends."""
    lean_rad: Range
    base_gap_m: Range
    """Free floor beside the base of a leaning book, on the side that it does not lean to."""
    spare_m: float
    """How much more than the new book a group of slots has room for, once all books stand."""
    slack_m: float
    """Between neighbours that stand."""
    max_redraws: int


@dataclass(frozen=True, slots=True)
class Standing:
    """One book of the row."""

    title: str
    T_world_book: np.ndarray
    """(4, 4) float64."""
    thickness_m: float
    height_m: float
    fixed: bool

    def face_x_m(self, side: int, z_m: np.ndarray | float) -> np.ndarray:
        """World x of its left (-1) or right (+1) face at world heights; see `face_x_m`."""
        return face_x_m(self.T_world_book, self.thickness_m, self.height_m, side, z_m)


def face_x_m(
    T_world_book: np.ndarray,
    thickness_m: float,
    height_m: float,
    side: int,
    z_m: np.ndarray | float,
) -> np.ndarray:
    """World x of a book's left (-1) or right (+1) face at world heights.

    The book may lean left or right. Below and above the face, its lower and upper edges count.
    """
    base = T_world_book[:3, 3] + T_world_book[:3, 0] * side * thickness_m / 2
    up = T_world_book[:3, 2]
    along = np.clip((np.asarray(z_m) - base[2]) / up[2], 0.0, height_m)
    return np.asarray(base[0] + along * up[0])


def leaning_pose(
    edge_x_m: float, y_m: float, floor_m: float, thickness_m: float, lean_rad: float
) -> np.ndarray:
    """Pose (4, 4) of a book that stands on one lower edge.

    Args:
        edge_x_m: World x of that edge: the left one when it leans left.
        y_m: World y of the middle of the book.
        floor_m: Height of the floor.
        thickness_m: Of the book.
        lean_rad: To the right when positive; 0 stands upright, `edge_x_m` being the left edge.
    """
    sin, cos = np.sin(lean_rad), np.cos(lean_rad)
    R = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    side = 1.0 if lean_rad > 0 else -1.0
    edge = np.array([edge_x_m, y_m, floor_m])
    return make_transform(R, edge - R[:, 0] * side * thickness_m / 2)


def lean_for_room(extra_m: float, thickness_m: float, height_m: float) -> float:
    """Angle at which a book takes `extra_m` more width than when it stands upright, rad."""
    reach = np.hypot(height_m, thickness_m)
    share = (extra_m + thickness_m) / reach
    if not 0 <= share <= 1:
        return float("nan")
    return float(np.arcsin(share) - np.arctan2(thickness_m, height_m))


def draw_row(
    rng: np.random.Generator, row: RowConfig, books: BooksConfig, *, floor_m: float, y_m: float,
    new_thickness_m: float, slots: int | None, keys: str,
) -> tuple[Standing, ...]:  # fmt: skip
    """Draw a row of books, from left to right, the large ones of both ends included.

    Args:
        rng: The only source of chance.
        row: Ranges.
        books: The catalogue.
        floor_m: Height of the shelf's floor.
        y_m: World y of the middles of the books.
        new_thickness_m: Thickness of the book that is to find room in every group of slots.
        slots: How many slots there shall be; None draws it.
        keys: YAML mapping that `row` was read from (`variants.sim.row`), for messages.

    Raises:
        ConfigError: `slots` is out of range.
        PlacementError: No row was found within the ranges.
    """
    wanted = drawn_count("places: free slots", slots, row.slots, rng)
    maker = _RowMaker(rng, row, books, floor_m, y_m, new_thickness_m)
    for _ in range(row.max_redraws):
        found = maker.try_row(PATTERNS[wanted])
        if found is not None:
            return found
    raise PlacementError(
        f"cannot set up a row of {row.count[0]} to {row.count[1]} books with {wanted} slots in "
        f"{row.row_width_m:g} m ({row.max_redraws} tries); change '{keys}.row_width_m' or "
        f"'{keys}.count', or widen '{keys}.lean_rad' and '{keys}.base_gap_m'"
    )


class _RowMaker:
    """One try after the other at a row of given ranges."""

    def __init__(
        self, rng: np.random.Generator, row: RowConfig, books: BooksConfig, floor_m: float,
        y_m: float, new_thickness_m: float,
    ) -> None:  # fmt: skip
        self._rng, self._row, self._books = rng, row, books
        self._floor_m, self._y_m, self._new_m = floor_m, y_m, new_thickness_m

    def try_row(self, groups: tuple[int, ...]) -> tuple[Standing, ...] | None:
        """A row with these groups of leaning books, or None when this draw does not fit."""
        rng, row = self._rng, self._row
        count = int(rng.integers(row.count[0], row.count[1] + 1))
        order = rng.permutation(len(row.shelf_books))[:count]
        titles = [row.shelf_books[i] for i in order]
        starts = self._group_starts(groups, count)
        if starts is None:
            return None
        signs = self._signs(groups, starts, count)
        tight = sum(
            1 for left, right in zip([0, *signs], [*signs, 0], strict=True) if not (left or right)
        )
        thickness = sum(self._books.catalogue[t].thickness_m for t in titles)
        extra = row.row_width_m - thickness - row.slack_m * tight
        leans = self._leans(titles, groups, starts, extra)
        if leans is None:
            return None
        placed = self._place(titles, signs, *leans)
        return placed if self._rests(placed, signs) else None

    def _group_starts(self, groups: tuple[int, ...], count: int) -> list[int] | None:
        """Number of the first leaning book of each group; one standing book parts two groups."""
        free = count - sum(groups) - (len(groups) - 1)
        if free < 0:
            return None
        before = np.sort(self._rng.integers(0, free + 1, size=len(groups)))
        starts, used = [], 0
        for skip, size in zip(before, groups, strict=True):
            starts.append(int(skip) + used)
            used += size + 1
        return starts

    def _signs(self, groups: tuple[int, ...], starts: Sequence[int], count: int) -> list[int]:
        """-1 for a book that leans left, +1 right, 0 for one that stands."""
        signs = [0] * count
        for size, start in zip(groups, starts, strict=True):
            if size == 2:
                signs[start], signs[start + 1] = -1, 1
            else:
                signs[start] = int(self._rng.choice((-1, 1)))
        return signs

    def _leans(
        self, titles: Sequence[str], groups: tuple[int, ...], starts: Sequence[int],
        extra_m: float,
    ) -> tuple[dict[int, float], dict[int, float]] | None:  # fmt: skip
        """Angle of each leaning book and free floor of each group, by number, filling `extra_m`."""
        rng, row = self._rng, self._row
        shares = rng.uniform(0.8, 1.2, size=len(groups))
        shares = shares / shares.sum()
        angles, gaps = {}, {}
        for size, start, share in zip(groups, starts, shares, strict=True):
            room = extra_m * float(share)
            gap = float(rng.uniform(*row.base_gap_m))
            if room < self._new_m + row.spare_m:
                return None
            parts = rng.uniform(0.8, 1.2, size=size)
            for i, part in enumerate((room - gap) * parts / parts.sum()):
                book = self._books.catalogue[titles[start + i]]
                angle = lean_for_room(float(part), book.thickness_m, book.height_m)
                # Near the balance a book could as well fall back and stand.
                balance = np.arctan2(book.thickness_m, book.height_m)
                if not max(row.lean_rad[0], 1.1 * balance) <= angle <= row.lean_rad[1]:
                    return None
                angles[start + i] = angle
            gaps[start] = gap
        return angles, gaps

    def _place(
        self, titles: Sequence[str], signs: Sequence[int], angles: dict[int, float],
        gaps: dict[int, float],
    ) -> tuple[Standing, ...]:  # fmt: skip
        row, catalogue = self._row, self._books.catalogue
        cursor = -row.row_width_m / 2
        placed = self._side_books(0, cursor)
        previous = 0
        for i, (title, sign) in enumerate(zip(titles, signs, strict=True)):
            book = catalogue[title]
            sin, cos = np.sin(angles.get(i, 0.0)), np.cos(angles.get(i, 0.0))
            if sign == 0:
                cursor += row.slack_m if previous == 0 else 0.0
                edge, cursor = cursor, cursor + book.thickness_m
            elif sign < 0:
                edge = cursor + book.height_m * sin
                cursor = edge + book.thickness_m * cos + gaps[i]
            else:
                cursor += gaps.get(i, 0.0)
                edge = cursor + book.thickness_m * cos
                cursor = edge + book.height_m * sin
            pose = leaning_pose(
                edge, self._y_m, self._floor_m, book.thickness_m, sign * angles.get(i, 0.0)
            )
            placed.append(Standing(title, pose, book.thickness_m, book.height_m, fixed=False))
            previous = sign
        return (*placed, *self._side_books(1, row.row_width_m / 2))

    def _side_books(self, end: int, x_m: float) -> list[Standing]:
        """The large books of one end, from left to right; `x_m` is where they meet the row."""
        titles = self._row.side_books[end]
        widths = [self._books.catalogue[t].thickness_m for t in titles]
        x = x_m - sum(widths) if end == 0 else x_m
        placed = []
        for title, width in zip(titles, widths, strict=True):
            pose = leaning_pose(x, self._y_m, self._floor_m, width, 0.0)
            height = self._books.catalogue[title].height_m
            placed.append(Standing(title, pose, width, height, fixed=True))
            x += width
        return placed

    def _rests(self, placed: Sequence[Standing], signs: Sequence[int]) -> bool:
        """Whether each leaning book's upper edge meets its neighbour's face, not the air above."""
        first = len(self._row.side_books[0])
        for i, sign in enumerate(signs):
            if sign:
                book, support = placed[first + i], placed[first + i + sign]
                upper_z = book.height_m * book.T_world_book[2, 2]
                if upper_z > support.height_m - 0.004:
                    return False
        return True
