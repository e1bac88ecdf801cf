"""A template library and a task, fitted together: every sentence that can be drawn."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from codediffuser.datagen.instructions.templates import OTHER, Template, TemplateLibrary
from codediffuser.datagen.task import Task
from codediffuser.errors import ConfigError
from codediffuser.registry import unknown_name


@dataclass(frozen=True, slots=True)
class Sentence:
    """A template with words for its placeholders, before any scene is drawn."""

    template: Template
    words: Mapping[str, str]
    """Placeholder to the words that fill it."""

    @property
    def text(self) -> str:
        """What is said."""
        return self.template.fill(self.words)


class Phrasebook:
    """Draws sentences of one library for one task.

    Args:
        task: Knows the phrases.
        library: Names those to use, with `*` for any words.

    Raises:
        ConfigError: The task does not know a phrase of the library, or knows it under another
            category; the message gives file and key.
    """

    def __init__(self, task: Task, library: TemplateLibrary) -> None:
        self.library = library
        self._pick = task.pick_category
        self.phrases = expand_phrases(task, library)

    def templates(
        self, *, picks: int | None = None, places: int | None = None
    ) -> tuple[Template, ...]:
        """Sentences that so many objects to pick and free places leave possible; None is any.

        What is "other" must be there beside what is meant, so such sentences need two.
        """
        return tuple(
            t
            for t in self.library.templates
            if not (picks == 1 and self._names_other(t, pick=True))
            and not (places == 1 and self._names_other(t, pick=False))
        )

    def _names_other(self, template: Template, *, pick: bool) -> bool:
        others = {p.removeprefix(OTHER) for p in template.placeholders if p.startswith(OTHER)}
        return any((category == self._pick) == pick for category in others)

    def draw_template(
        self,
        rng: np.random.Generator,
        *,
        kind: str | None = None,
        picks: int | None = None,
        places: int | None = None,
    ) -> Template:
        """A kind, evenly, and one of its sentences, evenly; `kind` fixes the first.

        Raises:
            ConfigError: No sentence is possible with so few objects or places.
        """
        by_kind: dict[str, list[Template]] = {}
        for template in self.templates(picks=picks, places=places):
            if kind in (None, template.kind):
                by_kind.setdefault(template.kind, []).append(template)
        if not by_kind:
            raise ConfigError(
                f"{self.library.source}: key 'tasks.{self.library.task}.templates': every sentence "
                f"{f'of kind {kind} ' if kind else ''}mentions an 'other' object or place, with "
                f"picks {picks or 'any'} and places {places or 'any'} there is none; ask for more, "
                "or add a sentence without {other_...}"
            )
        chosen = by_kind[list(by_kind)[rng.integers(len(by_kind))]]
        return chosen[rng.integers(len(chosen))]

    def draw_words(self, template: Template, rng: np.random.Generator) -> Sentence:
        """Words for each placeholder, evenly; what is other is never said in the same words."""
        words: dict[str, str] = {}
        for placeholder in template.placeholders:
            category = placeholder.removeprefix(OTHER)
            said = {words.get(category), words.get(OTHER + category)}
            choices = self.phrases[category]
            if any(w in said for w in choices):
                choices = tuple(w for w in choices if w not in said) or choices
            words[placeholder] = choices[rng.integers(len(choices))]
        return Sentence(template, words)


def expand_phrases(task: Task, library: TemplateLibrary) -> Mapping[str, tuple[str, ...]]:
    """Category to the phrases of the task that a library names, in the task's order for `*`.

    Raises:
        ConfigError: As for `Phrasebook`.
    """
    known: dict[str, list[str]] = {}
    for phrase in task.components().values():
        known.setdefault(phrase.category, []).append(phrase.words)
    expanded = {}
    for category, patterns in library.phrases.items():
        where = f"{library.source}: key 'tasks.{library.task}.components"
        if category not in known:
            raise ConfigError(f"{where}': {unknown_name('category', category, list(known))}")
        found: dict[str, None] = {}
        for pattern in patterns:
            fitting = [w for w in known[category] if _fits(w, pattern)]
            if not fitting:
                raise ConfigError(
                    f"{where}.{category}': {unknown_name('phrase', pattern, known[category])}"
                )
            found.update(dict.fromkeys(fitting))
        expanded[category] = tuple(found)
    return expanded


def _fits(words: str, pattern: str) -> bool:
    return words == pattern or ("*" in pattern and fnmatch.fnmatchcase(words, pattern))
