"""What a scene's words name, worked out anew from the file alone, to check the sampler by.

Shares no code with the phrases that the sampler uses (`instructions/components.py` and those of
the tasks): rules here go from the words themselves, and give how clearly they fit beside the ids.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec
from codediffuser.datagen.task_config import Observer

CLEAR = float("inf")
"""The lead of words that tell things apart by more than a distance: colour, title, row."""
SAME_BAND_M = 0.005
"""Places this near along an axis lie in one row, column or level."""


@dataclass(frozen=True, slots=True)
class Named:
    """What words name."""

    ids: frozenset[str]
    lead_m: float
    """How far ahead of the next candidate; below zero is impossible, 0 a tie."""


Rule = Callable[["Oracle", "re.Match[str]", str], Named]
RULES: list[tuple[re.Pattern[str], Rule]] = []


def _rule(pattern: str) -> Callable[[Rule], Rule]:
    def enter(rule: Rule) -> Rule:
        RULES.append((re.compile(pattern), rule))
        return rule

    return enter


class Oracle:
    """Answers for one scene.

    Args:
        scene: The file.
        observer: Whose directions the words mean.
    """

    def __init__(self, scene: SceneSpec, observer: Observer) -> None:
        self.waiting = {o.id: o for o in scene.objects if not o.fixed and o.place is None}
        self.others = {o.id: o for o in scene.objects if o.id not in self.waiting}
        self.places = {p.id: np.array(p.position_m) for p in scene.places}
        taken = {o.place for o in scene.objects}
        self.free = {i: at for i, at in self.places.items() if i not in taken}
        self.axes = {
            "left": np.array([*observer.left, 0.0]), "right": np.array([*observer.right, 0.0]),
            "front": np.array([*observer.front, 0.0]), "back": np.array([*observer.back, 0.0]),
        }  # fmt: skip

    def named(self, words: str, pick: str) -> Named | None:
        """What words name, seen from one picked object; None when no rule knows the words."""
        for pattern, rule in RULES:
            if match := pattern.fullmatch(words):
                return rule(self, match, pick)
        return None

    def book(self, words: str) -> list[ObjectSpec]:
        """All books that a title or `the <colour> book` fits, wherever they are."""
        books = [o for o in (*self.waiting.values(), *self.others.values()) if o.label]
        if match := re.fullmatch(r"the (\w+) book", words):
            return [o for o in books if o.name == f"{match[1]} book"]
        return [o for o in books if o.label == words]

    def shelved_x(self, words: str) -> float | None:
        """Where the one shelved book of this name stands along "right", or None."""
        found = self.book(words)
        if len(found) != 1 or found[0].id in self.waiting:
            return None
        return self.along_shelf(found[0])

    def along_shelf(self, book: ObjectSpec) -> float:
        """Middle of a book along "right", m; that of a leaning one is off its base."""
        middle = book.T_world_object @ np.array([0, 0, book.shape["height_m"] / 2, 1.0])
        return float(self.axes["right"] @ middle[:3])


@_rule(r"(left|right|front|back)-most (\w+)")
def _extreme(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    axis = oracle.axes[match[1]]
    return _first({i: float(axis @ np.array(o.position_m)) for i, o in oracle.waiting.items()})


@_rule(r"(nearest|furthest) (slot|branch)")
def _by_distance(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    start = np.array(oracle.waiting[pick].position_m)
    sign = -1 if match[1] == "nearest" else 1
    return _first({i: sign * float(np.linalg.norm(at - start)) for i, at in oracle.free.items()})


@_rule(r"slot on (?:the )?(front-most|middle|back-most|left|right) (?:row|columns?)")
def _band(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    across = "row" in match[0]
    word = match[1].removesuffix("-most")
    axis = oracle.axes["front" if across else "left"] if word == "middle" else oracle.axes[word]
    along = {i: float(axis @ at) for i, at in oracle.places.items()}
    low, high = min(along.values()), max(along.values())
    if word == "middle":
        band = {i for i, a in along.items() if low + SAME_BAND_M < a < high - SAME_BAND_M}
    else:
        band = {i for i, a in along.items() if a > high - SAME_BAND_M}
    return Named(frozenset(band & set(oracle.free)), CLEAR)


@_rule(r"(\w+) mug")
def _mug(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    found = [i for i, o in oracle.waiting.items() if o.name == match[0]]
    return Named(frozenset(found if len(found) == 1 else ()), CLEAR)


@_rule(r"(?:(left|right)-?)?(top|topmost|middle)? ?branch")
def _branch(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    middle = np.mean(list(oracle.places.values()), axis=0)
    top = max(at[2] for at in oracle.places.values())
    found = set(oracle.free)
    if match[1]:
        found = {
            i for i in found if oracle.axes[match[1]] @ (oracle.free[i] - middle) > SAME_BAND_M
        }
    if match[2]:
        high = {i for i in found if oracle.free[i][2] > top - SAME_BAND_M}
        found = found - high if match[2] == "middle" else high
    return Named(frozenset(found if len(found) == 1 else ()), CLEAR)


@_rule(r"right next to (.+) on its (left|right) side")
def _beside(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    start = oracle.shelved_x(match[1])
    if start is None:
        return Named(frozenset(), CLEAR)
    sign = 1 if match[2] == "right" else -1
    row = [oracle.along_shelf(o) for o in oracle.others.values() if o.label]
    ahead = [sign * (x - start) for x in row if sign * (x - start) > 0]
    slots = {i: sign * (float(oracle.axes["right"] @ at) - start) for i, at in oracle.free.items()}
    return Named(
        frozenset(i for i, d in slots.items() if 0 < d < min(ahead, default=np.inf)), CLEAR
    )


@_rule(r"to the (left|right) of (.+)")
def _one_side(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    start = oracle.shelved_x(match[2])
    sign = 1 if match[1] == "right" else -1
    slots = {i: float(oracle.axes["right"] @ at) for i, at in oracle.free.items()}
    return Named(
        frozenset(i for i, x in slots.items() if start is not None and sign * (x - start) > 0),
        CLEAR,
    )


@_rule(r"between (.+) and (.+)")
def _between(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    one, other = oracle.shelved_x(match[1]), oracle.shelved_x(match[2])
    if one is None or other is None:
        return Named(frozenset(), CLEAR)
    low, high = min(one, other), max(one, other)
    slots = {i: float(oracle.axes["right"] @ at) for i, at in oracle.free.items()}
    return Named(frozenset(i for i, x in slots.items() if low < x < high), CLEAR)


@_rule(r"the book on the pad")
def _only_book(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    return Named(frozenset(oracle.waiting if len(oracle.waiting) == 1 else ()), CLEAR)


@_rule(r"the \w+ book|[A-Z][^{}]*")
def _book(oracle: Oracle, match: re.Match[str], pick: str) -> Named:
    found = oracle.book(match[0])
    one = len(found) == 1 and found[0].id in oracle.waiting
    return Named(frozenset({found[0].id} if one else ()), CLEAR)


def _first(values: Mapping[str, float]) -> Named:
    """The largest, and by how much it leads."""
    ranked = sorted(values, key=lambda i: values[i], reverse=True)
    if not ranked:
        return Named(frozenset(), CLEAR)
    lead = values[ranked[0]] - values[ranked[1]] if len(ranked) > 1 else CLEAR
    return Named(frozenset(ranked[:1]), lead)


@dataclass(frozen=True, slots=True)
class Meaning:
    """What an instruction allows, and how clear its least clear words are."""

    pairs: frozenset[Pair]
    smallest_lead_m: float
    other_ids: frozenset[str]
    """What is mentioned but not meant, of all categories."""
    unknown_words: tuple[str, ...]
    """Words without a rule: they could not be checked."""
    empty_words: tuple[str, ...]
    """Words that name nothing, or more than the one thing that they promise."""


def meaning(scene: SceneSpec, observer: Observer, pick_category: str) -> Meaning:
    """Work out what a scene's stored words allow."""
    oracle, words = Oracle(scene, observer), scene.instruction.components
    lead, others = CLEAR, set[str]()
    unknown, empty = set[str](), set[str]()
    pairs: set[Pair] = set()

    def ids(phrase: str, pick: str) -> frozenset[str]:
        nonlocal lead
        found = oracle.named(phrase, pick)
        if found is None:
            unknown.add(phrase)
            return frozenset()
        lead = min(lead, found.lead_m)
        if not found.ids:
            empty.add(phrase)
        return found.ids

    anyone = next(iter(oracle.waiting))
    excluded = words.get(f"other_{pick_category}")
    picks = set(oracle.waiting)
    if excluded is not None:
        out = ids(excluded, anyone)
        others |= out
        picks -= out
    if pick_category in words:
        picks = set(ids(words[pick_category], anyone))
    for pick in picks:
        places = set(oracle.free)
        for placeholder, phrase in words.items():
            if placeholder.removeprefix("other_") == pick_category:
                continue
            found_ids = ids(phrase, pick)
            if placeholder.startswith("other_"):
                others |= {f"{pick}>{place}" for place in found_ids}
            else:
                places &= found_ids
        pairs |= {(pick, place) for place in places}
    return Meaning(
        frozenset(pairs), lead, frozenset(others), tuple(sorted(unknown)), tuple(sorted(empty))
    )
