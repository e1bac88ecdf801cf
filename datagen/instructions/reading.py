"""From the words of an instruction to every pair of object and place that it allows.

The law: an instruction allows exactly the pairs {(object, place)} where the object is among those
that its words name (any waiting one when they name none) and the place among those that its words
name for that object (any free one when they name none). Phrases of the task's pick category name
objects; phrases of every other category name places.
"""

from __future__ import annotations

from collections.abc import Mapping

from codediffuser.datagen.instructions.components import Arrangement, Component
from codediffuser.datagen.instructions.templates import OTHER
from codediffuser.datagen.scene import Pair
from codediffuser.datagen.task import Task
from codediffuser.errors import InstructionError
from codediffuser.registry import unknown_name

NO_IDS: frozenset[str] = frozenset()


def allowed_pairs(task: Task, scene: Arrangement, words: Mapping[str, str]) -> tuple[Pair, ...]:
    """Every (object, place) that an instruction allows, sorted; see `Reading.pairs`."""
    return Reading(task, scene).pairs(words)


class Reading:
    """One scene, to be asked about instructions: what each phrase names is found once.

    Args:
        task: Gives the phrases and the category of what is picked.
        scene: What is spoken about.
    """

    def __init__(self, task: Task, scene: Arrangement) -> None:
        self._pick = task.pick_category
        self._phrases: Mapping[str, Component] = task.components()
        self._scene = scene
        self._waiting = tuple(o.id for o in scene.pickable)
        self._free = tuple(p.id for p in scene.free_places)
        self._known: dict[tuple[str, str | None], tuple[str, ...]] = {}

    def pairs(self, words: Mapping[str, str]) -> tuple[Pair, ...]:
        """Every (object, place) that these words allow, sorted.

        Args:
            words: Placeholder to the words that fill it; empty for a sentence that names nothing.

        Raises:
            InstructionError: Words are unknown, name nothing or not clearly, or what is "other" is
                also what is meant.
        """
        found = []
        for object_id in self._picks(words):
            found += [(object_id, place_id) for place_id in self._places(words, object_id)]
        if not found:
            raise InstructionError("the words allow no pair of object and place")
        return tuple(sorted(found))

    def _picks(self, words: Mapping[str, str]) -> tuple[str, ...]:
        """Objects that are meant. Naming only the other one means all the rest of them."""
        said = words.get(self._pick)
        others = self._others(self._pick, words, None)
        if said is None:
            return tuple(i for i in self._waiting if i not in others)
        meant = self._named(self._pick, said, None)
        self._check_apart(words, self._pick, meant, others)
        return meant

    def _places(self, words: Mapping[str, str], object_id: str) -> tuple[str, ...]:
        """Places that are meant for one object: those that every place phrase names."""
        meant = self._free
        for category in dict.fromkeys(p.removeprefix(OTHER) for p in words):
            if category == self._pick:
                continue
            if category in words:
                named = self._named(category, words[category], object_id)
                meant = tuple(i for i in meant if i in named)
            others = self._others(category, words, object_id)
            self._check_apart(words, category, meant, others)
        return meant

    def _others(
        self, category: str, words: Mapping[str, str], pick_id: str | None
    ) -> frozenset[str]:
        """Ids that are mentioned in a category, but not meant."""
        said = words.get(OTHER + category)
        return NO_IDS if said is None else frozenset(self._named(category, said, pick_id))

    def _named(self, category: str, words: str, pick_id: str | None) -> tuple[str, ...]:
        """Ids that words name; an error when they name nothing."""
        key = (words, pick_id)
        if key not in self._known:
            self._known[key] = self._phrase(category, words).extract(self._scene, pick_id)
        ids = self._known[key]
        if not ids:
            relation = f" for {pick_id}" if pick_id else ""
            raise InstructionError(f"'{words}'{relation} fits nothing in the scene, or not clearly")
        return ids

    def _phrase(self, category: str, words: str) -> Component:
        phrase = self._phrases.get(words)
        if phrase is None or phrase.category != category:
            known = [w for w, p in self._phrases.items() if p.category == category]
            raise InstructionError(unknown_name(f"phrase for a {category}", words, known))
        return phrase

    def _check_apart(
        self, words: Mapping[str, str], category: str, meant: tuple[str, ...],
        others: frozenset[str],
    ) -> None:  # fmt: skip
        if both := sorted(others.intersection(meant)):
            raise InstructionError(
                f"'{words[OTHER + category]}' is the other {category}, yet "
                f"'{words.get(category, f'a {category}')}' means {', '.join(both)} too"
            )
