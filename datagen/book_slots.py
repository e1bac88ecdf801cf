"""Slots between the books of a row: where they are, and between which books."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.book_row import Standing, face_x_m
from codediffuser.datagen.bookshelf import ShelfConfig
from codediffuser.datagen.scene import ObjectSpec, PlaceSpec, SceneSpec

REGION_MARGIN_M = 0.002
"""How far the region of a slot keeps off the faces beside it, so that their points stay out."""
REGION_SHARE = 0.45
"""Of the height of its neighbours that the region of a slot takes up. Slots on both sides of a
leaning book are wide at opposite ends, so with less than half of it regions never meet."""
CLEARANCE_M = 0.001
"""Between a well-placed book and the standing book that it is put beside."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A free space between two neighbours, of which one or both lean."""

    left: Standing
    right: Standing

    def corners_m(self, z_m: tuple[float, float]) -> np.ndarray:
        """(4, 2) world x and z: lower left, lower right, upper right, upper left."""
        heights = np.array(z_m)
        left = self.left.face_x_m(1, heights)
        right = self.right.face_x_m(-1, heights)
        low, high = z_m
        return np.array([[left[0], low], [right[0], low], [right[1], high], [left[1], high]])

    def new_book_x_m(self, thickness_m: float, floor_m: float, height_m: float) -> float:
        """World x of the middle of a book that is stowed here, beside a neighbour that stands."""
        left_firm, right_firm = _stands(self.left.T_world_book), _stands(self.right.T_world_book)
        if left_firm:
            return float(self.left.face_x_m(1, floor_m)) + CLEARANCE_M + thickness_m / 2
        if right_firm:
            return float(self.right.face_x_m(-1, floor_m)) - CLEARANCE_M - thickness_m / 2
        low, high = free_width(
            self.left.face_x_m(1, np.linspace(floor_m, height_m, 20)),
            self.right.face_x_m(-1, np.linspace(floor_m, height_m, 20)),
        )
        return (low + high) / 2


def _stands(T_world_book: np.ndarray) -> bool:
    return bool(T_world_book[2, 2] > 0.9995)


def free_width(left_faces_x_m: np.ndarray, right_faces_x_m: np.ndarray) -> tuple[float, float]:
    """World x between which nothing stands at any height; low > high where there is no room."""
    return float(left_faces_x_m.max()), float(right_faces_x_m.min())


def row_places(
    row: Sequence[Standing], shelf: ShelfConfig, depth_m: float, new_thickness_m: float
) -> tuple[list[PlaceSpec], dict[int, str]]:
    """All places between the large books of the two ends, from left to right, and who takes them.

    Returns:
        The places, `slot_00`, `slot_01`, ...: one for each book, one for each free slot.
        Number in the row to the place that this book takes.
    """
    places: list[PlaceSpec] = []
    taken: dict[int, str] = {}
    y = shelf.spine_y_m + depth_m / 2
    for i, book in enumerate(row):
        if not book.fixed:
            taken[i] = f"slot_{len(places):02d}"
            places.append(_taken_place(book, taken[i], depth_m))
        if i + 1 < len(row) and not (
            _stands(book.T_world_book) and _stands(row[i + 1].T_world_book)
        ):
            slot = Slot(book, row[i + 1])
            places.append(
                _free_place(slot, f"slot_{len(places):02d}", shelf, y, depth_m, new_thickness_m)
            )
    return places, taken


def _taken_place(book: Standing, place_id: str, depth_m: float) -> PlaceSpec:
    corners = np.array(
        [
            (book.T_world_book @ [x, y, z, 1])[:3]
            for x in (-book.thickness_m / 2, book.thickness_m / 2)
            for y in (-depth_m / 2, depth_m / 2)
            for z in (0.0, book.height_m)
        ]
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    return _place(place_id, book.T_world_book[:3, 3], low, high)


def _free_place(
    slot: Slot, place_id: str, shelf: ShelfConfig, y_m: float, depth_m: float, thickness_m: float
) -> PlaceSpec:
    """The wide end of a slot, lower or upper, from the lip of the shelf to its back."""
    low, high = free_region(slot, shelf, depth_m)
    top = shelf.floor_m + min(slot.left.height_m, slot.right.height_m)
    x = slot.new_book_x_m(thickness_m, shelf.floor_m, top)
    return _place(place_id, np.array([x, y_m, shelf.floor_m]), low, high)


def free_region(
    slot: Slot, shelf: ShelfConfig, depth_m: float
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """What is called the slot: corners (3,), (3,) of a box around its wide end, world, metres.

    It reaches from the lip of the shelf to its back.
    """
    y_m = shelf.spine_y_m + depth_m / 2
    height = min(slot.left.height_m, slot.right.height_m)
    top = shelf.floor_m + height
    corners = slot.corners_m((shelf.floor_m, top))
    wide_below = corners[1, 0] - corners[0, 0] > corners[2, 0] - corners[3, 0]
    x_low, x_high = corners[:2, 0] if wide_below else corners[:1:-1, 0]
    reach = height * REGION_SHARE
    z_low, z_high = (shelf.floor_m, shelf.floor_m + reach) if wide_below else (top - reach, top)
    low = np.array([x_low + REGION_MARGIN_M, y_m - depth_m / 2 - shelf.lip_m, z_low - 0.004])
    high = np.array([x_high - REGION_MARGIN_M, y_m + depth_m / 2 + 0.006, z_high])
    return low, high


def _place(
    place_id: str, position_m: np.ndarray, low_m: np.ndarray, high_m: np.ndarray
) -> PlaceSpec:
    def triple(values: np.ndarray) -> tuple[float, float, float]:
        return (float(values[0]), float(values[1]), float(values[2]))

    return PlaceSpec(
        id=place_id,
        category="slot",
        position_m=triple(position_m),
        size_m=triple(high_m - low_m),
        center_m=triple((low_m + high_m) / 2),
    )


def shelved_books(scene: SceneSpec) -> list[ObjectSpec]:
    """The books on the shelf, from left to right."""
    waiting = {o.id for o in scene.pickable}
    books = [o for o in scene.objects if o.category == "book" and o.id not in waiting]
    return sorted(books, key=lambda o: middle_x_m(o.T_world_object, o))


def middle_x_m(T_world_book: np.ndarray, book: ObjectSpec) -> float:
    """World x of the middle of a book, half-way up."""
    return float(T_world_book[0, 3] + T_world_book[0, 2] * book.shape["height_m"] / 2)


def row_beside(scene: SceneSpec, place_id: str) -> tuple[list[ObjectSpec], list[ObjectSpec]]:
    """The books left of a place and those right of it, each from left to right."""
    x = scene.place(place_id).position_m[0]
    books = shelved_books(scene)
    left = [o for o in books if middle_x_m(o.T_world_object, o) < x]
    return left, books[len(left) :]


def slot_corners_m(left: ObjectSpec, right: ObjectSpec, z_m: tuple[float, float]) -> np.ndarray:
    """Free space between two books at reset, (4, 2): x and z from the lower left, around."""
    low, high = z_m
    xs = [
        face_x_m(o.T_world_object, o.shape["thickness_m"], o.shape["height_m"], side, z)
        for o, side, z in ((left, 1, low), (right, -1, low), (right, -1, high), (left, 1, high))
    ]
    return np.array([[float(x), z] for x, z in zip(xs, (low, low, high, high), strict=True)])


def free_between(
    left: ObjectSpec, T_world_left: np.ndarray, right: ObjectSpec, T_world_right: np.ndarray,
    z_m: tuple[float, float],
) -> tuple[float, float]:  # fmt: skip
    """World x between two neighbours that is free at all heights of a range; may be negative."""
    heights = np.linspace(*z_m, 20)
    return free_width(
        face_x_m(T_world_left, left.shape["thickness_m"], left.shape["height_m"], 1, heights),
        face_x_m(T_world_right, right.shape["thickness_m"], right.shape["height_m"], -1, heights),
    )
