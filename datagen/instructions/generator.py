"""Words for a scene: choose a sentence that includes the target, and list every pair it allows.

The law of the whole module: an instruction allows exactly the pairs
{(object, place): object among those its words name (any waiting one if they name none), place among
those its words name for that object (any free one if they name none)}.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from codediffuser.datagen.instructions.components import Arrangement, Component
from codediffuser.datagen.instructions.templates import (
    OTHER,
    Template,
    TemplateLibrary,
    load_templates,
)
from codediffuser.datagen.scene import InstructionSpec, Pair, SceneSpec, Target
from codediffuser.datagen.task import Task, get_task
from codediffuser.errors import ConfigError, InstructionError
from codediffuser.registry import unknown_name


def allowed_pairs(task: Task, scene: Arrangement, words: Mapping[str, str]) -> tuple[Pair, ...]:
    """Every (object, place) that an instruction with these words allows, sorted.

    A sentence that names only `{other_<object>}` means all the others ("put the other one away").

    Args:
        task: Gives the phrases and the two categories.
        scene: What is spoken about.
        words: Placeholder to the words that fill it; empty for a sentence that names nothing.

    Raises:
        InstructionError: Words are unknown, name nothing or not clearly, or what is "other" is
            also what is meant.
    """
    pick, place = task.pick_category, task.place_category
    phrases = {key: _phrase(task, key, text) for key, text in words.items()}
    waiting = tuple(o.id for o in scene.pickable)
    picks = _named(phrases, pick, scene, waiting)
    if OTHER + pick in phrases:
        others = _named(phrases, OTHER + pick, scene, ())
        picks = picks if pick in phrases else tuple(i for i in picks if i not in others)
        if set(picks) & set(others):
            raise InstructionError(
                f"'{words[OTHER + pick]}' is meant and also the other {pick}: {', '.join(others)}"
            )
    pairs = []
    free = tuple(p.id for p in scene.free_places)
    for object_id in picks:
        places = _named(phrases, place, scene, free, object_id)
        if OTHER + place in phrases:
            others = _named(phrases, OTHER + place, scene, (), object_id)
            if set(places) & set(others):
                raise InstructionError(
                    f"'{words[OTHER + place]}' is the other {place}, but '{words[place]}' names "
                    f"some of the same for {object_id}"
                )
        pairs += [(object_id, place_id) for place_id in places]
    if not pairs:
        raise InstructionError("the instruction allows no pair of object and place")
    return tuple(sorted(pairs))


def _named(
    phrases: Mapping[str, Component], placeholder: str, scene: Arrangement,
    default: tuple[str, ...], pick_id: str | None = None,
) -> tuple[str, ...]:  # fmt: skip
    """What the phrase of a placeholder names, `default` without one; an error when nothing."""
    if placeholder not in phrases:
        return default
    ids = phrases[placeholder].extract(scene, pick_id)
    if not ids:
        relation = f" of {pick_id}" if pick_id else ""
        raise InstructionError(
            f"'{phrases[placeholder].words}'{relation} fits nothing in the scene, or not clearly"
        )
    return ids


def _phrase(task: Task, placeholder: str, words: str) -> Component:
    category = placeholder.removeprefix(OTHER)
    phrases = {w: c for w, c in task.components().items() if c.category == category}
    if words not in phrases:
        raise InstructionError(unknown_name(f"phrase for a {category}", words, list(phrases)))
    return phrases[words]


def make_instruction(
    task: Task,
    scene: Arrangement,
    target: Target,
    rng: np.random.Generator,
    library: TemplateLibrary | None = None,
) -> InstructionSpec:
    """Draw an instruction that allows the target.

    The slackness kind is drawn evenly among those that can be said of this scene and target, then
    the template among those of the kind, then the words among those that fit.

    Raises:
        InstructionError: No template of the library can be said of this scene and target.
        ConfigError: The library has phrases that the task does not know.
    """
    library = library or load_templates(task.name)
    check_library(task, library)
    possible: dict[str, list[tuple[Template, list[tuple[dict[str, str], tuple[Pair, ...]]]]]] = {}
    for template in library.templates:
        fillings = list(_fillings(task, scene, target, template, library))
        if fillings:
            possible.setdefault(template.kind, []).append((template, fillings))
    if not possible:
        raise InstructionError(
            f"no template of {library.source} for {library.task} can be said of target "
            f"({target.pick}, {target.place}); add a sentence of kind both_slackness"
        )
    kind = list(possible)[rng.integers(len(possible))]
    template, fillings = possible[kind][rng.integers(len(possible[kind]))]
    words, pairs = fillings[rng.integers(len(fillings))]
    return InstructionSpec(
        text=template.fill(words),
        kind=kind,
        template_id=template.id,
        components=words,
        pairs=pairs,
    )


def _fillings(
    task: Task, scene: Arrangement, target: Target, template: Template, library: TemplateLibrary
) -> Iterator[tuple[dict[str, str], tuple[Pair, ...]]]:
    """Words for a template's placeholders that make it true of the target, with all their pairs."""
    choices = [library.phrases[p.removeprefix(OTHER)] for p in template.placeholders]
    for chosen in product(*choices):
        words = dict(zip(template.placeholders, chosen, strict=True))
        try:
            pairs = allowed_pairs(task, scene, words)
        except InstructionError:
            continue  # These words do not fit this scene; others may.
        if (target.pick, target.place) in pairs:
            yield words, pairs


def check_library(task: Task, library: TemplateLibrary) -> None:
    """Raise `ConfigError` unless the task knows every phrase of the library, under its category."""
    known = {c: [] for c in (task.pick_category, task.place_category)}  # type: dict[str, list[str]]
    for phrase in task.components().values():
        known[phrase.category].append(phrase.words)
    for category, phrases in library.phrases.items():
        where = f"{library.source}: key 'tasks.{library.task}.components"
        if category not in known:
            raise ConfigError(f"{where}': {unknown_name('category', category, list(known))}")
        for words in phrases:
            if words not in known[category]:
                raise ConfigError(
                    f"{where}.{category}': {unknown_name('phrase', words, known[category])}"
                )


def check_instruction(scene: SceneSpec, task: Task | None = None) -> None:
    """Check by rule that a scene's instruction says what the scene stores of it.

    Args:
        scene: Sampled here, or written by hand.
        task: The scene's task with the YAML it was drawn from; None takes the one that ships.

    Raises:
        InstructionError: Words are missing from the sentence, the pairs differ from those that the
            words allow, or the target is not among them.
    """
    task = task or get_task(scene.task)
    said, where = scene.instruction, f"scene {scene.scene_id}"
    for words in said.components.values():
        if words not in said.text:
            raise InstructionError(f"{where}: '{words}' is not in the sentence {said.text!r}")
    try:
        pairs = allowed_pairs(task, scene, said.components)
    except InstructionError as error:
        raise InstructionError(f"{where}: {said.text!r}: {error}") from None
    if pairs != said.pairs:
        differing = sorted(set(pairs) ^ set(said.pairs))
        raise InstructionError(
            f"{where}: {said.text!r} allows {len(pairs)} pairs, the scene stores "
            f"{len(said.pairs)}; they differ in {differing[:4]}; sample the scene again"
        )
    if (scene.target.pick, scene.target.place) not in pairs:
        raise InstructionError(
            f"{where}: {said.text!r} does not allow the target "
            f"({scene.target.pick}, {scene.target.place})"
        )
