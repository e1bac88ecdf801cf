"""Take the book from the pad and stow it in a slot of a shelf, pushing its neighbours aside.

Randomised: which books stand on the shelf, in which order, which of them lean, to which side and
how far; which book waits, where, and how it is turned.
Success: the book stands in a slot that the instruction allows, between the right neighbours, spine
out, in line with the row, released and at rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import model_validator

from codediffuser.datagen import drawing
from codediffuser.datagen.book_drawing import pad_from_above, shelf_from_front
from codediffuser.datagen.book_row import RowConfig, draw_row
from codediffuser.datagen.book_slots import row_places, shelved_books
from codediffuser.datagen.bookshelf import (
    BooksConfig,
    ShelfConfig,
    book_geometry,
    book_object,
    shelf_geometry,
    shelf_object,
)
from codediffuser.datagen.box_row import BoxRow
from codediffuser.datagen.instructions.book_components import Named, book_phrases
from codediffuser.datagen.instructions.book_reach import BooksOfScenes, can_be_said
from codediffuser.datagen.instructions.components import Component
from codediffuser.datagen.layout import Layout, LayoutRequest, fixed_count
from codediffuser.datagen.ranges import Range
from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec
from codediffuser.datagen.stowing_check import SuccessConfig, check_stowed, stowing_failure
from codediffuser.datagen.stowing_script import StowingScript, StowingScriptConfig
from codediffuser.datagen.task import TASKS, Check, Geometry, Move, Pad, SceneView, Task
from codediffuser.datagen.task_config import TaskConfig
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.poses import make_transform, rotation_z
from codediffuser.registry import unknown_name
from codediffuser.schema import Strict


class VariantConfig(Strict):
    """Ranges that scenes are drawn from."""

    row: RowConfig
    pad_books: tuple[str, ...]
    """Titles of the books that may wait."""
    pad_x_m: Range
    """Of the middle of the waiting book, like the next."""
    pad_y_m: Range
    pad_yaw_rad: Range
    """0 turns the spine to the robot."""


class StowBookConfig(TaskConfig[VariantConfig]):
    """Everything in `stow_book.yaml`."""

    shelf: ShelfConfig
    books: BooksConfig
    success: SuccessConfig
    script: StowingScriptConfig

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
class StowBook(Task[StowBookConfig, VariantConfig]):
    """Stow the waiting book in one slot of the shelf."""

    name: ClassVar[str] = "stow_book"
    config_type: ClassVar[type[TaskConfig]] = StowBookConfig
    pick_category: ClassVar[str] = "book"
    place_category: ClassVar[str] = "slot"
    push_phases: ClassVar[tuple[str, ...]] = ("approach", "turn")

    def __init__(self, config: StowBookConfig | None = None) -> None:
        super().__init__(config)
        books = self.config.books
        thickness = [b.thickness_m for b in books.catalogue.values()]
        self.row = BoxRow(self.config.shelf, books.depth_m, (min(thickness), max(thickness)))

    def arrange(self, rng: np.random.Generator, asked: LayoutRequest[VariantConfig]) -> Layout:
        """A row of books of which one or two lean, and one more book on the pad."""
        fixed_count("picks: waiting books", asked.picks, 1)
        ranges, books, shelf = asked.ranges, self.config.books, self.config.shelf
        new_title = ranges.pad_books[rng.integers(len(ranges.pad_books))]
        new_thickness = books.catalogue[new_title].thickness_m
        row = draw_row(
            rng, ranges.row, books, floor_m=shelf.floor_m,
            y_m=shelf.spine_y_m + books.depth_m / 2, new_thickness_m=new_thickness,
            slots=asked.places, keys=f"{asked.key}.row",
        )  # fmt: skip
        places, taken = row_places(row, shelf, books.depth_m, new_thickness)
        spot = [rng.uniform(*ranges.pad_x_m), rng.uniform(*ranges.pad_y_m), 0.0]
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
        return Layout((*objects, shelf_object(shelf, inner, books.depth_m)), tuple(places))

    def phrases(self) -> Iterable[Component]:
        """Titles and colours; slots next to a book, on one side of it, between two books."""
        variants, catalogue = self.config.variants.values(), self.config.books.catalogue
        waiting = dict.fromkeys(t for v in variants for t in v.pad_books)
        shelved = dict.fromkeys(
            t for v in variants for t in (*sum(v.row.side_books, ()), *v.row.shelf_books)
        )

        def names(titles: Iterable[str]) -> list[Named]:
            colors = dict.fromkeys(catalogue[title].color for title in titles)
            return [
                *(Named(title, label=title) for title in titles),
                *(Named(f"the {color} book", name=f"{color} book") for color in colors),
            ]

        side = self.config.observer
        return book_phrases(names(waiting), names(shelved), side.left, side.right)

    def never_said(self) -> frozenset[str]:
        """Slots beyond the ends of the row, a book that is called like one of its ends, ..."""
        names = {title: f"{b.color} book" for title, b in self.config.books.catalogue.items()}
        scenes = [
            BooksOfScenes(left, v.row.shelf_books, right, v.pad_books, names)
            for v in self.config.variants.values()
            for left, right in (v.row.side_books,)
        ]
        return frozenset(
            words
            for words, phrase in self.components().items()
            if not any(can_be_said(phrase, books) for books in scenes)
        )

    def pads(self, variant: str) -> tuple[Pad, ...]:
        """One pad under everywhere that the waiting book may stand."""
        ranges, picture = self.ranges(variant), self.config.reset_image
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
        return StowingScript(config.script, config.shelf, config.books, view, rng).moves()

    def check_success(self, view: SceneView, pairs: Sequence[Pair]) -> Check:
        """Whether the book stands where one of the pairs wants it, and all is at rest."""
        return check_stowed(self.config.success, self.config.shelf.floor_m, view, pairs)

    def failure_phase(self, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]) -> str:
        """Phase and what happened in it: `grasp:missed`, `push:blocked`, `press:not_flush`."""
        return stowing_failure(
            self.config.success, self.config.shelf.floor_m, scene, trajectory, pairs
        )
