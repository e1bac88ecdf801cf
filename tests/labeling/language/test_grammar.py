from __future__ import annotations

import contextlib
import time

import numpy as np
import pytest

from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.errors import InstructionError
from codediffuser.labeling.language.checker import check_program
from codediffuser.labeling.language.composer import compose_program
from codediffuser.labeling.language.grammar import parse_instruction
from codediffuser.labeling.language.lexicon import KINDS
from codediffuser.labeling.language.meaning import Band, Description


def short(described: Description) -> str:
    """`left`, `back row`, `nearest`, `green`, ... in one line, `any` for a plain phrase."""
    bands = [f"{b.side} {b.axis}" for b in described.bands]
    far = [f"{described.distance.kind}"] if described.distance else []
    other = ["other"] if described.other else []
    return " ".join([*other, *described.looks, *described.sides, *bands, *far]) or "any"


MEANINGS = {
    # The examples of the paper's real-world section.
    "Put the leftmost battery into the slot in the back row.": ("left", "back row"),
    "Place a battery into the slot in the right column.": ("any", "right column"),
    "I need to use the leftmost battery. Put away the middle battery in a slot.": ("middle", "any"),
    "There are some batteries. Put one into a slot.": ("any", "any"),
    # Sentences that are in no template.
    "Could you put the right-most battery into the nearest slot, please?": ("right", "nearest"),
    "Into the nearest slot, put the left-most battery.": ("left", "nearest"),
    "The left-most battery should go into the furthest slot.": ("left", "furthest"),
    "Take the front-most battery and put it into the slot closest to it.": ("front", "nearest"),
    "Fill the nearest slot with the left-most battery.": ("left", "nearest"),
    "Move the battery from the table into the nearest slot.": ("any", "nearest"),
    "Put the battery on the table in the right column": ("any", "right column"),
    "Put the battery on the left into the slot on the right side of the crate.": ("left", "right"),
    "Place one of the batteries into the crate.": ("any", "any"),
    "Move one of the two batteries to the front row of the crate.": ("any", "front row"),
    "Put the green battery into the back left slot.": ("green", "back left"),
    "Place the left-most battery in the left-most slot of the back row.": (
        "left", "left back row",
    ),
    "Grab the rightmost one and drop it in the middle row's left column.": (
        "right", "middle row left column",
    ),
    "Put the battery nearest to the crate into the back row, left column.": (
        "nearest", "back row left column",
    ),
    "Put the left-most battery back into the crate.": ("left", "any"),
    "There is one battery left. Put it in the crate.": ("any", "any"),
    "There is a green battery on the table. Put it into the nearest slot.": ("green", "nearest"),
    "I will not use the right-most battery now. Put it in a slot.": ("right", "any"),
    "Please move the battery that is furthest to the left to the far row.": ("left", "back row"),
}  # fmt: skip


@pytest.mark.parametrize("text", MEANINGS)
def test_a_sentence_means_its_pick_and_place(text: str) -> None:
    request = parse_instruction(text)
    assert (short(request.pick), short(request.place)) == MEANINGS[text]


CORRECTIONS = {
    "I want to put a battery into the nearest slot, oh sorry, the slot on the left column.": (
        "any", "left column",
    ),
    "I want to put the left-most battery into a slot, oh sorry, the right-most battery.": (
        "right", "any",
    ),
    "Put the left-most battery in the nearest slot. Sorry, the right-most battery.": (
        "right", "nearest",
    ),
    "Put the left-most battery in the nearest slot, no wait, the furthest one.": (
        "left", "furthest",
    ),
    "Put the left-most battery in the nearest slot. Sorry, the right-most one into the furthest "
    "one.": ("right", "furthest"),
    "Put the left-most battery into the nearest slot. Put it in the back row instead.": (
        "left", "back row",
    ),
    "Put a battery, no, the right-most battery, into the left column, no, the right column.": (
        "right", "right column",
    ),
}  # fmt: skip


@pytest.mark.parametrize("text", CORRECTIONS)
def test_a_correction_replaces_the_last_phrase_of_its_kind(text: str) -> None:
    request = parse_instruction(text)
    assert (short(request.pick), short(request.place)) == CORRECTIONS[text]
    assert request.excluded == ()


EXCLUSIONS = {
    "I need to use the right-most battery. Put away the left-most battery in a slot.": "right",
    "I need to use the left-most battery. Put the other one into the back row.": "left",
    "Keep the left-most battery on the table, put the other one in a slot.": "left",
    "Don't use the left-most battery. Put another one into the middle column.": "left",
    "Put any battery except the left-most into any slot.": "left",
    "Put a battery, not the left-most one, into a slot.": "left",
    "Put a battery into a slot, but don't put it in the nearest one.": "nearest",
    "I need the left-most battery, oh sorry, the back-most battery. Put the other one in a slot.": (
        "back"
    ),
}


@pytest.mark.parametrize("text", EXCLUSIONS)
def test_what_must_stay_is_left_out(text: str) -> None:
    assert [short(e) for e in parse_instruction(text).excluded] == [EXCLUSIONS[text]]


def test_every_template_with_every_phrase_is_understood() -> None:
    library = load_templates("pack_battery")
    for template in library.templates:
        for battery in library.phrases["battery"]:
            for slot in library.phrases["slot"]:
                others = {"other_battery": "left-most battery", "other_slot": "nearest slot"}
                words = {"battery": battery, "slot": slot, **others}
                request = parse_instruction(template.fill(words))
                named = (
                    short(request.pick) if "{battery}" in template.text else battery,
                    short(request.place) if "{slot}" in template.text else slot,
                )
                assert named[0].split("-")[0] == battery.split("-")[0], template.text
                if "{slot}" in template.text:
                    expected = slot.replace("-most", "").replace("columns", "column")
                    expected = expected.replace("slot on ", "").replace("the ", "")
                    assert named[1] == expected.replace(" slot", ""), template.text


def test_spelling_variants_mean_the_same() -> None:
    texts = [
        f"Put the {word} battery into a slot."
        for word in ("leftmost", "left-most", "left most", "LEFT-MOST", "left", "far left")
    ]
    assert {parse_instruction(t).pick.sides for t in texts} == {("left",)}


def test_the_reference_of_a_distance_is_kept_apart_from_the_pick() -> None:
    place = parse_instruction(
        "Put the battery closest to you into the slot furthest from the left-most battery."
    ).place
    assert place.distance is not None
    assert isinstance(place.distance.reference, Description)
    assert place.distance.reference.sides == ("left",)


def test_middle_columns_are_one_band() -> None:
    request = parse_instruction("Put a battery in a slot of the middle columns")
    assert request.place.bands == (Band("column", "middle"),)


ERRORS = {
    "Put the battry into a slot.": r"'battry' \(did you mean 'battery'\?\)",
    "Put the battery sideways into a slot.": "'sideways'",
    "Put the second battery from the left into a slot.": "'second'",
    "Put the left-most battery in the top row.": "'top'",
    "Put the battery into the first row.": "'first'",
    "Put the battery in the left row.": "a row is one of front, middle, back, got 'left'",
    "Pick the left-most battery.": "names no slot",
    "Fill the nearest slot.": "names no battery",
    "Put it in a slot.": "'it' refers to no battery",
    "Put the other one in a slot.": "other than what",
    "Put both batteries into slots.": "more than one",
    "Put the left-most battery into the nearest slot and the right-most battery into the furthest "
    "slot.": "two things of category battery",
    "hello": "names no battery",
    "": "empty",
    " ... ,": "empty",
    "把电池放进盒子里": "not understood",
}


@pytest.mark.parametrize("text", ERRORS)
def test_what_is_not_understood_is_named(text: str) -> None:
    with pytest.raises(InstructionError, match=ERRORS[text]) as caught:
        parse_instruction(text)
    assert "\n" not in str(caught.value)


def test_any_words_in_any_order_are_understood_or_refused() -> None:
    rng = np.random.default_rng(0)
    words = [*sorted(KINDS), ",", ".", "sorry", "the", "a", "battery", "slot", "it", "in", "on"]
    understood = 0
    for _ in range(2_000):
        text = " ".join(rng.choice(words, size=rng.integers(1, 20)))
        try:
            check_program(compose_program(text))
            understood += 1
        except InstructionError as error:
            assert "\n" not in str(error)
    assert understood > 5


@pytest.mark.parametrize("part", ["on the left of the ", "in the back row of ", "nearest to the "])
def test_long_chains_are_read_in_no_time(part: str) -> None:
    began = time.perf_counter()
    with contextlib.suppress(InstructionError):
        parse_instruction("Put the battery " + part * 50 + "slot.")
    assert time.perf_counter() - began < 1.0


def test_errors_say_what_could_be_said() -> None:
    with pytest.raises(InstructionError, match=r"left-most.*nearest.*'a' for any"):
        parse_instruction("Put the frobnicated battery into a slot.")
