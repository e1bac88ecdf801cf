"""Take the book from the pad and stow it in a slot of a shelf, pushing its neighbours aside.

Randomised: which books stand on the shelf, in which order, which of them lean, to which side and
how far; which book waits, where, and how it is turned.
Success: the book stands in a slot that the instruction allows, between the right neighbours, spine
out, in line with the row, released and at rest.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import model_validator

from codediffuser.datagen import drawing
from codediffuser.datagen.book_drawing import pad_from_above, shelf_from_front
from codediffuser.datagen.book_row import RowConfig, draw_row
from codediffuser.datagen.book_slots import middle_x_m, row_beside, row_places, shelved_books
from codediffuser.datagen.bookshelf import (
    BooksConfig,
    ShelfConfig,
    book_geometry,
    book_object,
    shelf_geometry,
    shelf_object,
)
from codediffuser.datagen.instructions.book_components import Named, book_phrases
from codediffuser.datagen.instructions.components import Component, by_words
from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec
from codediffuser.datagen.stow_motion import StowMotion, StowScriptConfig
from codediffuser.datagen.task import (
    TASKS,
    Check,
    Condition,
    Geometry,
    Layout,
    Move,
    Pad,
    SceneView,
    Task,
    TaskConfig,
)
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import ConfigError
from codediffuser.poses import make_transform, rotation_z
from codediffuser.registry import unknown_name
from codediffuser.schema import Strict

PAD_TOP_M = 0.0


class VariantConfig(Strict):
    """Ranges that scenes are drawn from."""

    row: RowConfig
    pad_books: tuple[str, ...]
    """Titles of the books that may wait."""
    pad_x_m: tuple[float, float]
    """Of the middle of the waiting book, like the next."""
    pad_y_m: tuple[float, float]
    pad_yaw_rad: tuple[float, float]
    """0 turns the spine to the robot."""


class ResetImageConfig(Strict):
    """How the operator's picture is drawn."""

    pad_margin_m: float
    """How far the pad reaches beyond the area that books cover."""
    cross_spacing_m: float


class SuccessConfig(Strict):
    """Thresholds of `check_success`."""

    min_beside_m: float
    """Between the middles of the book and of its neighbours, along the shelf."""
    min_upright: float
    min_spine_out: float
    """Cosine of the angle between the spine and the plane of the row."""
    max_depth_error_m: float
    """Between the book and the row, along the depth of the shelf."""
    max_base_height_m: float
    """Of the book above the floor of the shelf."""
    max_row_shift_m: float
    """How far any book of the row may have moved out of line."""
    min_opening_m: float
    min_hand_distance_m: float
    max_speed_mps: float
    max_spin_radps: float


class StowBookConfig(TaskConfig):
    """Everything in `stow_book.yaml`."""

    shelf: ShelfConfig
    books: BooksConfig
    variants: dict[str, VariantConfig]
    reset_image: ResetImageConfig
    success: SuccessConfig
    script: StowScriptConfig

    @model_validator(mode="after")
    def _titles_are_known(self) -> Self:
        known = list(self.books.catalogue)
        for name, variant in self.variants.items():
            row = variant.row
            for key, titles in (
                ("row.side_books", sum(row.side_books, ())),
                ("row.shelf_books", row.shelf_books),
                ("pad_books", variant.pad_books),
            ):
                for title in titles:
                    if title not in known:
                        raise ValueError(
                            f"variants.{name}.{key}: {unknown_name('title', title, known)}"
                        )
            if not 1 <= row.count[0] <= row.count[1] <= len(row.shelf_books):
                raise ValueError(
                    f"variants.{name}.row.count: expected 1 <= low <= high <= "
                    f"{len(row.shelf_books)}, the number of shelf_books"
                )
            if not 2 <= row.slots[0] <= row.slots[1] <= 4:
                raise ValueError(f"variants.{name}.row.slots: expected 2 <= low <= high <= 4")
        return self


@TASKS.add("stow_book")
class StowBook(Task[StowBookConfig]):
    """Stow the waiting book in one slot of the shelf."""

    name: ClassVar[str] = "stow_book"
    config_type: ClassVar[type[TaskConfig]] = StowBookConfig
    pick_category: ClassVar[str] = "book"
    place_category: ClassVar[str] = "slot"

    def sample_layout(
        self,
        rng: np.random.Generator,
        *,
        variant: str = "sim",
        picks: int | None = None,
        places: int | None = None,
    ) -> Layout:
        """A row of books of which one or two lean, and one more book on the pad."""
        if picks not in (None, 1):
            raise ConfigError(f"picks: waiting books: expected 1, got {picks}")
        ranges, books, shelf = self._ranges(variant), self.config.books, self.config.shelf
        new_title = ranges.pad_books[rng.integers(len(ranges.pad_books))]
        new_thickness = books.catalogue[new_title].thickness_m
        row = draw_row(
            rng, ranges.row, books, floor_m=shelf.floor_m,
            y_m=shelf.spine_y_m + books.depth_m / 2, new_thickness_m=new_thickness, slots=places,
            keys=f"variants.{variant}.row",
        )  # fmt: skip
        places_found, taken = row_places(row, shelf, books.depth_m, new_thickness)
        spot = [rng.uniform(*ranges.pad_x_m), rng.uniform(*ranges.pad_y_m), PAD_TOP_M]
        waiting = make_transform(rotation_z(rng.uniform(*ranges.pad_yaw_rad)), np.array(spot))
        objects = [book_object(books, new_title, "book_00", waiting)]
        objects += [
            book_object(
                books, book.title, f"book_{i + 1:02d}", book.T_world_book,
                place=taken.get(i), fixed=book.fixed,
            )
            for i, book in enumerate(row)
        ]  # fmt: skip
        inner = ranges.row.row_width_m + sum(b.thickness_m for b in row if b.fixed)
        return Layout((*objects, shelf_object(shelf, inner, books.depth_m)), tuple(places_found))

    def _ranges(self, variant: str) -> VariantConfig:
        if variant not in self.config.variants:
            raise ConfigError(unknown_name("variant", variant, list(self.config.variants)))
        return self.config.variants[variant]

    def components(self) -> Mapping[str, Component]:
        """Titles and colours; slots next to a book, on one side of it, between two books."""
        return self._components

    @functools.cached_property
    def _components(self) -> dict[str, Component]:
        variants, catalogue = self.config.variants.values(), self.config.books.catalogue
        waiting = dict.fromkeys(t for v in variants for t in v.pad_books)
        shelved = dict.fromkeys(
            t for v in variants for t in (*sum(v.row.side_books, ()), *v.row.shelf_books)
        )

        def names(titles: Iterator[str]) -> list[Named]:
            found = list(titles)
            colors = dict.fromkeys(catalogue[title].color for title in found)
            return [
                *(Named(title, label=title) for title in found),
                *(Named(f"the {color} book", name=f"{color} book") for color in colors),
            ]

        side = self.config.observer
        return by_words(
            list(book_phrases(names(iter(waiting)), names(iter(shelved)), side.left, side.right))
        )

    def pads(self, variant: str) -> tuple[Pad, ...]:
        """One pad under everywhere that the waiting book may stand."""
        ranges, picture = self._ranges(variant), self.config.reset_image
        thickness = max(self.config.books.catalogue[t].thickness_m for t in ranges.pad_books)
        half_x, half_y = thickness / 2, self.config.books.depth_m / 2
        yaw = max(abs(angle) for angle in ranges.pad_yaw_rad)
        reach_x = half_x * np.cos(yaw) + half_y * np.sin(yaw) + picture.pad_margin_m
        reach_y = half_y + picture.pad_margin_m
        low = (ranges.pad_x_m[0] - reach_x, ranges.pad_y_m[0] - reach_y)
        high = (ranges.pad_x_m[1] + reach_x, ranges.pad_y_m[1] + reach_y)
        return (Pad("pad", low, high, picture.cross_spacing_m),)

    def draw_reset(self, scene: SceneSpec) -> drawing.Drawing:
        """The shelf from the front, with titles, and the pad from above; the targets in green."""
        (pad,) = self.pads(scene.variant)
        return drawing.reset_page(
            scene,
            (
                shelf_from_front(scene, self.config.shelf),
                pad_from_above(scene, pad, self.config.observer),
            ),
            notes=(f"{len(shelved_books(scene))} on the shelf", f"{scene.ambiguity.places} slots"),
        )

    def geometry(self, obj: ObjectSpec) -> Geometry:
        """Shelf: floor, walls, back. Book: one convex body with its title on the spine."""
        if obj.category == "shelf":
            return shelf_geometry(obj, self.config.shelf, self.config.books.friction)
        return book_geometry(obj, self.config.books)

    def script(self, view: SceneView, rng: np.random.Generator) -> Iterator[Move]:
        """Take the book by its spine, push it in between its neighbours, press it flush."""
        config = self.config
        return StowMotion(config.script, config.shelf, config.books, view, rng).moves()

    def check_success(self, view: SceneView, pairs: Sequence[Pair]) -> Check:
        """Whether the book stands where one of the pairs wants it, and all is at rest."""
        judged = [Check(pair, self._conditions(view, pair)) for pair in pairs]
        if not judged:
            return Check(None, ())
        return max(judged, key=lambda c: (c.success, c.conditions[0].value))

    def _conditions(self, view: SceneView, pair: Pair) -> tuple[Condition, ...]:
        limits, scene = self.config.success, view.scene
        T, book = view.T_world_object(pair[0]), scene.object(pair[0])
        beside = self._beside_m(view, pair)
        row_y = scene.place(pair[1]).position_m[1]
        depth = abs(float(T[1, 3]) - row_y)
        height = abs(float(T[2, 3]) - self.config.shelf.floor_m)
        moved = [view.T_world_object(o.id)[1, 3] for o in shelved_books(scene) if not o.fixed]
        shift = max(abs(float(y) - row_y) for y in moved)
        opening = view.gripper_opening_m()
        middle = T[:3, 3] + T[:3, 2] * book.shape["height_m"] / 2
        hand_away = float(np.linalg.norm(view.T_world_hand()[:3, 3] - middle))
        released = opening > limits.min_opening_m or hand_away > limits.min_hand_distance_m
        speed, spin = view.object_speed(pair[0])
        at_least = [
            ("beside_m", beside, limits.min_beside_m),
            ("upright", float(T[2, 2]), limits.min_upright),
            ("spine_out", float(T[1, 1]), limits.min_spine_out),
        ]
        at_most = [
            ("depth_error_m", depth, limits.max_depth_error_m),
            ("base_height_m", height, limits.max_base_height_m),
            ("row_shift_m", shift, limits.max_row_shift_m),
            ("speed_mps", speed, limits.max_speed_mps),
            ("spin_radps", spin, limits.max_spin_radps),
        ]
        return (
            *(Condition(name, value, limit, value > limit) for name, value, limit in at_least),
            *(Condition(name, value, limit, value < limit) for name, value, limit in at_most),
            Condition("released_opening_m", opening, limits.min_opening_m, released),
        )

    def _beside_m(self, view: SceneView, pair: Pair) -> float:
        """How far the book stays off all that stood left of the slot, and all on its right."""
        scene = view.scene
        left, right = row_beside(scene, pair[1])

        def now(obj: ObjectSpec) -> float:
            T = obj.T_world_object if obj.fixed else view.T_world_object(obj.id)
            return middle_x_m(T, obj)

        x = now(scene.object(pair[0]))
        return min(x - max(now(o) for o in left), min(now(o) for o in right) - x)

    def failure_phase(self, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]) -> str:
        """Phase and what happened in it: `grasp:missed`, `push:blocked`, `press:not_flush`."""
        from codediffuser.datagen.views import TrajectoryView

        limits, shelf = self.config.success, self.config.shelf
        waiting = scene.pickable[0].id
        heights = trajectory.object_position_m[:, trajectory.object_ids.index(waiting), 2]
        if heights.max() - heights[0] < 0.02:
            return (
                "grasp:tipped"
                if trajectory.T_world_object(waiting, -1)[2, 2] < 0.9
                else "grasp:missed"
            )
        view = TrajectoryView(scene, trajectory)
        T = trajectory.T_world_object(waiting, -1)
        row_y = scene.places[0].position_m[1]
        inserted = float(T[1, 3]) > row_y - self.config.books.depth_m / 2
        held = any(
            c.name == "released_opening_m" and not c.holds for c in self._conditions(view, pairs[0])
        )
        if held:
            return "release:not_released" if inserted else "transport:timeout"
        if not inserted:
            return (
                "push:blocked"
                if T[2, 3] > shelf.floor_m - limits.max_base_height_m
                else "transport:dropped"
            )
        check = self.check_success(view, pairs)
        failed = [c.name for c in check.conditions if not c.holds]
        if "beside_m" in failed:
            return "push:wrong_slot"
        if "row_shift_m" in failed:
            return "push:row_disturbed"
        if {"upright", "base_height_m", "spine_out"} & set(failed):
            return "insert:tilted"
        return "press:not_flush" if "depth_error_m" in failed else "release:not_at_rest"
