"""Say a drawn sentence of a scene, and check by rule what a scene stores of its instruction.

What sentences mean is defined in `reading.py`; both directions go through it.
"""

from __future__ import annotations

from codediffuser.datagen.instructions.phrasebook import Sentence, expand_phrases
from codediffuser.datagen.instructions.reading import Reading, allowed_pairs
from codediffuser.datagen.instructions.templates import TemplateLibrary
from codediffuser.datagen.scene import InstructionSpec, SceneSpec
from codediffuser.datagen.task import Task, get_task
from codediffuser.errors import InstructionError


def make_instruction(reading: Reading, sentence: Sentence) -> InstructionSpec:
    """Say a sentence of the scene that is read.

    Raises:
        InstructionError: The sentence does not fit the scene: its words name nothing, not clearly,
            or what is "other" is also what is meant.
    """
    return InstructionSpec(
        text=sentence.text,
        kind=sentence.template.kind,
        template_id=sentence.template.id,
        template_split=sentence.template.split,
        components=dict(sentence.words),
        pairs=reading.pairs(sentence.words),
    )


def check_library(task: Task, library: TemplateLibrary) -> None:
    """Raise `ConfigError` unless the task knows every phrase of the library, under its category."""
    expand_phrases(task, library)


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
        if words.lower() not in said.text.lower():
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
