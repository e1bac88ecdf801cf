"""What phrases about a row of books name."""

from __future__ import annotations

import pytest

from codediffuser.datagen.instructions.book_components import Named, book_phrases
from codediffuser.datagen.instructions.components import Component
from codediffuser.datagen.layout import Layout
from codediffuser.datagen.scene import ObjectSpec, PlaceSpec

LEFT, RIGHT = (-1.0, 0.0), (1.0, 0.0)


def book(number: int, title: str, color: str, x_m: float, **more: object) -> ObjectSpec:
    return ObjectSpec(
        id=f"book_{number}", category="book", name=f"{color} book", position_m=(x_m, 0.2, 0.0),
        color_rgb=(0.5, 0.5, 0.5), label=title, shape={"height_m": 0.2}, **more,
    )  # fmt: skip


def place(number: int, x_m: float) -> PlaceSpec:
    return PlaceSpec(
        id=f"slot_{number}", category="slot", position_m=(x_m, 0.2, 0.0),
        size_m=(0.03, 0.1, 0.2), center_m=(x_m, 0.2, 0.1),
    )  # fmt: skip


@pytest.fixture
def row() -> Layout:
    """A | slot_1 | B C | slot_4 | D, and E waits; A and C are red, D is blue like E."""
    places = tuple(place(i, 0.1 * i) for i in range(6))
    books = (
        book(0, "E", "blue", 0.0),
        book(1, "A", "red", 0.0, place="slot_0"),
        book(2, "B", "green", 0.2, place="slot_2"),
        book(3, "C", "red", 0.3, place="slot_3"),
        book(4, "D", "blue", 0.5, place="slot_5"),
    )
    return Layout(books, places)


@pytest.fixture
def phrases() -> dict[str, Component]:
    def names(titles: str) -> list[Named]:
        colors = [Named(f"the {c} book", name=f"{c} book") for c in ("red", "green", "blue")]
        return [*(Named(t, label=t) for t in titles), *colors]

    return {p.words: p for p in book_phrases(names("EA"), names("ABCDE"), LEFT, RIGHT)}


@pytest.mark.parametrize(
    ("words", "slots"),
    [
        ("right next to A on its right side", ("slot_1",)),
        ("right next to B on its left side", ("slot_1",)),
        ("right next to the green book on its left side", ("slot_1",)),
        ("right next to B on its right side", ()),
        ("right next to A on its left side", ()),
        ("right next to D on its left side", ("slot_4",)),
        ("to the right of A", ("slot_1", "slot_4")),
        ("to the left of D", ("slot_1", "slot_4")),
        ("to the left of the green book", ("slot_1",)),
        ("to the right of D", ()),
        ("between A and D", ("slot_1", "slot_4")),
        ("between D and A", ("slot_1", "slot_4")),
        ("between A and the green book", ("slot_1",)),
        ("between B and C", ()),
    ],
)
def test_phrases_name_the_slots_that_they_say(
    words: str, slots: tuple[str, ...], row: Layout, phrases: dict[str, Component]
) -> None:
    assert phrases[words].extract(row) == slots


@pytest.mark.parametrize(
    "words",
    [
        "to the right of the red book",
        "to the left of the blue book",
        "to the left of E",
        "between A and the red book",
    ],
)
def test_a_name_that_two_books_or_only_the_waiting_one_have_names_no_slot(
    words: str, row: Layout, phrases: dict[str, Component]
) -> None:
    assert phrases[words].extract(row) == ()


def test_the_waiting_book_is_named_by_title_or_place_or_a_color_of_its_own(
    row: Layout, phrases: dict[str, Component]
) -> None:
    assert phrases["E"].extract(row) == ("book_0",)
    assert phrases["the book on the pad"].extract(row) == ("book_0",)
    assert phrases["A"].extract(row) == ()
    assert phrases["the blue book"].extract(row) == ()


def test_a_leaning_book_stands_where_its_middle_is(phrases: dict[str, Component]) -> None:
    # Its base lies right of the slot, its middle left of it.
    leaning = book(1, "A", "red", 0.13, quat_wxyz=(0.97, 0.0, -0.243, 0.0), place="slot_0")
    layout = Layout((book(0, "E", "blue", 0.0), leaning), (place(0, 0.0), place(1, 0.11)))
    assert phrases["to the right of A"].extract(layout) == ("slot_1",)
    assert phrases["to the left of A"].extract(layout) == ()


def test_every_phrase_has_one_of_the_four_categories(phrases: dict[str, Component]) -> None:
    assert {p.category for p in phrases.values()} == {"book", "slot", "side", "range"}
    assert len({p.words for p in phrases.values()}) == len(phrases)
