"""The built-in composer on the tasks whose places are branches and gaps, and on every task."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from codediffuser.datagen.instructions.phrasebook import expand_phrases
from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.datagen.task import TASKS, get_task
from codediffuser.errors import InstructionError
from codediffuser.labeling.language.check_grounding import ground_scenes
from codediffuser.labeling.language.checker import check_program
from codediffuser.labeling.language.composer import compose_program
from codediffuser.labeling.language.detection import compose_detection, variable
from codediffuser.labeling.language.grammar import parse_instruction
from codediffuser.labeling.language.grounding import ground
from codediffuser.labeling.language.instances import Instance, ListedInstances
from codediffuser.labeling.language.meaning import Description
from codediffuser.labeling.language.vocabulary import vocabulary_of

MUGS = vocabulary_of("hang_mug")
BOOKS = vocabulary_of("stow_book")


def short(described: Description) -> str:
    """`red`, `right top`, `|<tiger|`: adjacent relations in bars; `any` for a plain phrase."""
    words = [*described.looks, *described.sides]
    words += [described.level] if described.level else []
    words += [described.distance.kind] if described.distance else []
    words += ["other"] if described.other else []
    if relation := described.relation:
        anchors = "..".join(" ".join(a.looks) or a.said for a in relation.anchors)
        mark = {"left": "<", "right": ">", None: ""}[relation.side]
        words.append(f"|{mark}{anchors}|" if relation.adjacent else f"{mark}{anchors}")
    return " ".join(words) or "any"


HANGING = {
    "Put Bob's mug, the red mug, on the top branch.": ("red", "top"),
    "Put away a mug on the right branch.": ("any", "right"),
    "Hang the green mug on a branch. Sorry, the blue mug.": ("blue", "any"),
    "Hang the left-most mug on the right-topmost branch. Sorry, the left-middle branch.": (
        "left", "left middle",
    ),
    "I will not use this white mug now. Hang it on furthest branch": ("white", "furthest"),
    "There are two mugs. Keep one on the table, put the other one on a branch.": ("other", "any"),
    "Please take the cup on the left and hang it on the upper right hook.": ("left", "right top"),
    "The back-most mug belongs on the lowest peg of the tree.": ("back", "bottom"),
}  # fmt: skip


@pytest.mark.parametrize("text", HANGING)
def test_a_sentence_about_mugs_means_its_mug_and_branch(text: str) -> None:
    request = parse_instruction(text, MUGS)
    assert (short(request.pick), short(request.place)) == HANGING[text]


STOWING = {
    # The supplement's examples.
    "Place the front-most book so it sits directly next to DUBAI on the right side.": (
        "front", "|>dubai|",
    ),
    "Ensure LOST KINGDOMS is shelved on the orange book's right side. Sorry, the left side.": (
        "lost kingdoms", "<orange",
    ),
    "Put the Neo's book, Istanbul, onto the shelf so that it is between Urbanlike and the black "
    "book.": ("istanbul", "urbanlike..black"),
    # Our own.
    "Put the red book to the left of TIGER.": ("red", "<tiger"),
    "Put the red book immediately to the left of TIGER.": ("red", "|<tiger|"),
    "Push ECHO into any gap between COMET and the yellow book.": ("echo", "comet..yellow"),
    "Do not put ECHO to the left of TIGER; put it to the right of LEMON.": ("echo", ">lemon"),
    "There is room right next to RIVER on its left side. Stow ECHO there.": ("echo", "|<river|"),
    "I need ECHO to be between OPERA and RIVER, never mind which gap.": ("echo", "opera..river"),
    "Keep ECHO next to TIGER.": ("echo", "|tiger|"),
    "Put ECHO right next to COMET on its left side. No, wait, the right side.": (
        "echo", "|>comet|",
    ),
    "Put the book on the pad into a gap.": ("any", "any"),
    'Slide "The Long Way" to the right of the green book.': ("the long way", ">green"),
}  # fmt: skip


@pytest.mark.parametrize("text", STOWING)
def test_a_sentence_about_books_means_its_book_and_gap(text: str) -> None:
    request = parse_instruction(text, BOOKS)
    assert (short(request.pick), short(request.place)) == STOWING[text]


@pytest.mark.parametrize(
    "text",
    [
        "Not to the left of TIGER: ECHO has to go to the right of LEMON.",
        "First I thought to the left of TIGER, but ECHO must go to the right of LEMON.",
        "Do not put ECHO to the left of TIGER; put it to the right of LEMON.",
    ],
)
def test_a_place_that_is_ruled_out_is_kept_free(text: str) -> None:
    assert [short(e) for e in parse_instruction(text, BOOKS).excluded] == ["<tiger"]


@pytest.mark.parametrize("task_name", sorted(TASKS))
def test_every_template_of_every_task_becomes_a_program(task_name: str) -> None:
    library, words = load_templates(task_name), vocabulary_of(task_name)
    phrases = expand_phrases(get_task(task_name), library)
    for number, template in enumerate(library.templates):
        fillings = {
            p: phrases[p.removeprefix("other_")][
                (7 * number + 13 * i) % len(phrases[p.removeprefix("other_")])
            ]
            for i, p in enumerate(template.placeholders)
        }
        check_program(compose_program(template.fill(fillings), vocabulary=words))


@pytest.mark.parametrize("task_name", sorted(TASKS))
def test_answers_are_among_the_pairs_that_the_sentence_allows(task_name: str) -> None:
    results = list(ground_scenes(task_name, scenes=8, seed=5))
    assert [(r.scene.instruction.text, r.reason or r.answer) for r in results if not r.right] == []


def row_of_books() -> ListedInstances:
    """Three books in a row with gaps 0 to 3 around them, a fourth one on the pad."""

    def box(x: float, y: float) -> np.ndarray:
        corners = itertools.product((x - 0.01, x + 0.01), (y - 0.01, y + 0.01), (0.0, 0.2))
        return np.array(list(corners), dtype=np.float32)

    titles = {-0.1: "COMET", 0.0: "TIGER", 0.1: "LEMON"}
    names = {"COMET": "blue book", "TIGER": "orange book", "LEMON": "yellow book"}
    found = [Instance(t.lower(), "book", names[t], box(x, 0.2), label=t) for x, t in titles.items()]
    found.append(Instance("echo", "book", "yellow book", box(0.1, 0.0), label="ECHO"))
    found += [Instance(f"gap_{i}", "slot", "slot", box(-0.15 + 0.1 * i, 0.2)) for i in range(4)]
    found.append(
        Instance("shelf", "shelf", "shelf", np.concatenate([box(-0.2, 0.2), box(0.2, 0.2)]))
    )
    return ListedInstances(found, {"pick": "book", "place": "slot"}, vocabulary=BOOKS)


GAPS = {
    "right next to TIGER on its left side": "gap_1",
    "right next to TIGER on its right side": "gap_2",
    "to the right of LEMON": "gap_3",
    "to the left of the blue book": "gap_0",
    "between LEMON and TIGER": "gap_2",
    "between COMET and LEMON, but not next to the blue book": "gap_2",
}


@pytest.mark.parametrize("words", GAPS)
def test_gaps_are_found_by_the_books_around_them(words: str) -> None:
    grounding = ground(f"Put ECHO {words}.", row_of_books())
    assert (grounding.target("pick"), grounding.target("place")) == ("echo", GAPS[words])


@pytest.mark.parametrize("anchor", ["DUBAI", "the red book"])
def test_a_neighbour_that_is_not_there_leaves_no_gap(anchor: str) -> None:
    with pytest.raises(InstructionError, match="fits nothing in the scene"):
        ground(f"Put ECHO to the left of {anchor}.", row_of_books())


def test_messages_name_the_nouns_of_the_task() -> None:
    with pytest.raises(InstructionError, match=r"names no branch.*mugs \(left-most.*branches \("):
        parse_instruction("Hang the red mug.", MUGS)
    with pytest.raises(InstructionError, match=r"the word 'slott' .*between books"):
        parse_instruction("Put the red book into the slott.", BOOKS)


def test_a_battery_has_no_level_and_a_branch_no_row() -> None:
    with pytest.raises(InstructionError, match="nothing lies higher"):
        compose_program("Put the top battery into a slot.")
    with pytest.raises(InstructionError, match="no rows and columns"):
        compose_program("Hang a mug on the branch of the back row.", vocabulary=MUGS)


def test_names_of_categories_may_have_two_words() -> None:
    program = compose_detection("mug tree", ("mug", "branch", "mug tree"))
    assert 'self.get_obj("mug tree")' in program
    assert variable("mug tree") == "mug_tree"
    assert variable("1984") == "named_1984"
