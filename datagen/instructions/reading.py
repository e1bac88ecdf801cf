"""From the words of an instruction to every pair of object and place that it allows.

The law: an instruction allows exactly the pairs {(object, place)} where the object is among those
that its words name (any waiting one when they name none) and the place among those that its words
name for that object (any free one when they name none).
"""

from __future__ import annotations

from collections.abc import Mapping

from codediffuser.datagen.instructions.components import Arrangement, Component
from codediffuser.datagen.instructions.templates import OTHER
from codediffuser.datagen.scene import Pair
from codediffuser.datagen.task import Task
from codediffuser.errors import InstructionError
from codediffuser.registry import unknown_name


def allowed_pairs(task: Task, scene: Arrangement, words: Mapping[str, str]) -> tuple[Pair, ...]:
    """Every (object, place) that an instruction allows, sorted; see `Reading.pairs`."""
    return Reading(task, scene).pairs(words)


class Reading:
    """One scene, to be asked about many instructions: what each phrase names is found once.

    Args:
        task: Gives the phrases and the two categories.
        scene: What is spoken about.
    """

    def __init__(self, task: Task, scene: Arrangement) -> None:
        self._pick, self._place = task.pick_category, task.place_category
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
        meant = self._named(self._pick, words.get(self._pick), None)
        others = self._named(self._pick, words.get(OTHER + self._pick), None)
        if meant is not None and others is not None:
            self._check_apart(words, self._pick, meant, others)
        if meant is not None:
            return meant
        return tuple(i for i in self._waiting if i not in (others or ()))

    def _places(self, words: Mapping[str, str], object_id: str) -> tuple[str, ...]:
        """Places that are meant for one object."""
        meant = self._named(self._place, words.get(self._place), object_id)
        others = self._named(self._place, words.get(OTHER + self._place), object_id)
        meant = self._free if meant is None else meant
        if others is not None:
            self._check_apart(words, self._place, meant, others)
        return meant

    def _named(
        self, category: str, words: str | None, pick_id: str | None
    ) -> tuple[str, ...] | None:
        """Ids that words name; None when nothing is said; an error when they name nothing."""
        if words is None:
            return None
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
        others: tuple[str, ...],
    ) -> None:  # fmt: skip
        if both := sorted(set(meant) & set(others)):
            raise InstructionError(
                f"'{words[OTHER + category]}' is the other {category}, yet '{words[category]}' "
                f"means {', '.join(both)} too"
            )
