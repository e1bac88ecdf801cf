"""Words for a scene: choose a sentence that includes the target, and check one by rule.

What sentences mean is defined in `reading.py`; both directions go through it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from codediffuser.datagen.instructions.components import Arrangement
from codediffuser.datagen.instructions.reading import Reading, allowed_pairs
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

Filling = tuple[dict[str, str], tuple[Pair, ...]]
"""Placeholder to words, and all pairs that they allow."""


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
    reading = Reading(task, scene)
    possible: dict[str, list[tuple[Template, list[Filling]]]] = {}
    for template in library.templates:
        fillings = list(_fillings(reading, target, template, library))
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
    reading: Reading, target: Target, template: Template, library: TemplateLibrary
) -> Iterator[Filling]:
    """Words for a template's placeholders that make it true of the target, with all their pairs."""
    choices = [library.phrases[p.removeprefix(OTHER)] for p in template.placeholders]
    for chosen in product(*choices):
        words = dict(zip(template.placeholders, chosen, strict=True))
        try:
            pairs = reading.pairs(words)
        except InstructionError:
            continue  # These words do not fit this scene; others may.
        if (target.pick, target.place) in pairs:
            yield words, pairs


def check_library(task: Task, library: TemplateLibrary) -> None:
    """Raise `ConfigError` unless the task knows every phrase of the library, under its category."""
    known: dict[str, list[str]] = {task.pick_category: [], task.place_category: []}
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
