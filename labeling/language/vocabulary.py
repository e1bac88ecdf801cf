"""What the built-in composer knows of one task: its nouns, and by what its places are told apart.

All of it stands in the task's YAML under `words` (`datagen/task_words.py`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

from codediffuser.datagen.task import Task, get_task

DEFAULT_TASK = "pack_battery"
"""Whose words are meant where none are named."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The words of one task."""

    pick: str
    """Category of what is picked."""
    place: str
    """Category of what it is placed at."""
    holder: str | None
    """Category of what all places belong to; None when the scene has no such thing."""
    nouns: tuple[tuple[str, tuple[str, ...]], ...]
    """(Category, words for it): the usual one first, its plural behind it."""
    grid: tuple[int, int] | None = None
    """Places along the world's x and y, for tasks whose places lie in rows and columns."""
    level_m: float | None = None
    """How much lower than the highest a place is that is no longer `top`; None without levels."""
    neighbours: bool = False
    """Whether places are told by the things beside them."""
    titles: bool = False
    """Whether things bear titles."""

    @classmethod
    def of(cls, task: Task) -> Vocabulary:
        """The words in a task's YAML."""
        words = task.config.words
        categories = [task.pick_category, task.place_category, *filter(None, [words.holder])]
        nouns = {category: (category, f"{category}s") for category in categories} | words.nouns
        return cls(
            pick=task.pick_category,
            place=task.place_category,
            holder=words.holder,
            nouns=tuple(nouns.items()),
            grid=(words.grid.x, words.grid.y) if words.grid else None,
            level_m=words.level_m,
            neighbours=words.neighbours,
            titles=words.titles,
        )

    @property
    def categories(self) -> tuple[str, ...]:
        """All that there are words for."""
        return tuple(category for category, _ in self.nouns)

    @property
    def needed(self) -> tuple[str, ...]:
        """Categories that a scene must have for its words to be understood."""
        by_holder = self.holder is not None and (self.grid is not None or self.neighbours)
        return (self.pick, self.place, *([self.holder] if by_holder and self.holder else []))

    def words_for(self, category: str) -> tuple[str, ...]:
        """The words for one category; none for a category that is not known."""
        return dict(self.nouns).get(category, ())

    def plural(self, category: str) -> str:
        """The plural of the first word of a category."""
        first, *more = self.words_for(category)
        return next((w for w in more if w.startswith(first[:-1])), f"{first}s")

    @property
    def can_say(self) -> str:
        """What error messages offer."""
        looks = "by title or colour" if self.titles else "or by colour"
        picks = f"{self.plural(self.pick)} (left-most, right-most, front-most, back-most, middle, "
        places = "nearest, furthest, or left-most, right-most"
        if self.grid:
            places = (
                "nearest, furthest, or by front, middle, back row and left, middle, right column"
            )
        elif self.level_m:
            places = "nearest, furthest, left, right, top, middle"
        elif self.neighbours:
            places = f"right next to, to the left or right of, or between {self.plural(self.pick)}"
        return (
            f"{picks}{looks}), {self.plural(self.place)} ({places}), 'a' for any, "
            "'I need to use X' for what must stay, 'sorry, Y' for a correction, 'the other one'"
        )


@functools.cache
def vocabulary_of(task_name: str = DEFAULT_TASK) -> Vocabulary:
    """The words of a registered task.

    Raises:
        NotRegisteredError: No such task; the message names the closest one.
    """
    return Vocabulary.of(get_task(task_name))
