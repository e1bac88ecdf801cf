"""Initial configurations: a sentence first, then objects, places and a target that it allows.

Needs no simulator. Each scene comes from its own address (`codediffuser.seeding`), so neither the
number of workers nor the order nor earlier scenes change any of its bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datagen.configuration_split import configuration_split
from codediffuser.datagen.instructions.generator import make_instruction
from codediffuser.datagen.instructions.phrasebook import Phrasebook, Sentence
from codediffuser.datagen.instructions.reading import Reading
from codediffuser.datagen.instructions.templates import TemplateLibrary, load_templates
from codediffuser.datagen.layout import Layout
from codediffuser.datagen.sampling_settings import Factor, SamplingSettings
from codediffuser.datagen.scene import (
    Ambiguity,
    InstructionSpec,
    Pair,
    SceneSpec,
    SeedKey,
    Split,
    Target,
    TemplateSplit,
)
from codediffuser.datagen.strata import Stratum, make_strata, stratum_of
from codediffuser.datagen.task import Task
from codediffuser.errors import InstructionError, PlacementError
from codediffuser.seeding import Stage, rng_for

CHOICES_OF_WORDS = 16
"""Fillings of a sentence that are drawn ahead for each of its placeholders; a layout takes the
first of them that fits it."""
LAYOUTS_PER_CHOICE = 10
"""Layouts that are drawn until one fits; then other words are drawn."""
ROUNDS = 40
"""Choices of words before a scene is given up."""
WORDS_ADDRESS = 1_000_000
"""Attempt number of the generators that draw words; those of layouts count from 0."""


class SceneSource:
    """Draws scenes of one task by one set of settings.

    For each scene a slackness kind is drawn evenly, one of its sentences evenly, and a few choices
    of words for its placeholders, each evenly. Then layouts are drawn until one fits, and the
    target evenly among the pairs that the sentence allows there.

    Args:
        task: What to draw.
        settings: What all scenes have in common.
        library: Sentences; None takes those that ship.

    Raises:
        ConfigError: The settings, the library and the task do not fit together.
    """

    def __init__(
        self, task: Task, settings: SamplingSettings, library: TemplateLibrary | None = None
    ) -> None:
        self.task = task
        self.settings = settings
        self.library = (library or load_templates(task.name)).only(settings.template_split)
        self._phrasebook = Phrasebook(task, self.library)
        self._strata: tuple[Stratum, ...] = ()
        if settings.stratify:
            self._strata = make_strata(task, self._phrasebook, settings)

    def draw(self, index: int) -> SceneSpec:
        """Draw the scene with this number, >= 0.

        Raises:
            PlacementError: Objects find no room; the message names the key to change.
            InstructionError: No layout fits a sentence; the message names what to change.
            ConfigError: `variant`, `picks` or `places` is not what the task offers.
        """
        asked = Stratum(picks=self.settings.picks, places=self.settings.places)
        if self._strata:
            asked = stratum_of(self._strata, self.settings, index)
        reason = ""
        for number in range(ROUNDS):
            sentences = self._draw_sentences(index, number, asked)
            for repeat in range(LAYOUTS_PER_CHOICE):
                scene, reason = self._try(
                    index, number * LAYOUTS_PER_CHOICE + repeat, sentences, asked
                )
                if scene is not None:
                    return scene
        raise InstructionError(self._explain(index, asked, reason))

    def _draw_sentences(self, index: int, number: int, asked: Stratum) -> list[Sentence]:
        """One template for all tries of a scene, so that hard ones are not rarer, but new words."""
        rng = self._rng(index, WORDS_ADDRESS)
        if asked.template is not None:
            template = next(t for t in self.library.templates if t.id == asked.template)
        else:
            template = self._phrasebook.draw_template(
                rng, kind=asked.kind, picks=asked.picks, places=asked.places
            )
        rng = self._rng(index, WORDS_ADDRESS + 1 + number)
        count = max(1, CHOICES_OF_WORDS * len(template.placeholders))
        return [self._phrasebook.draw_words(template, rng) for _ in range(count)]

    def _try(
        self, index: int, attempt: int, sentences: Sequence[Sentence], asked: Stratum
    ) -> tuple[SceneSpec | None, str]:
        """One layout with the first sentence that fits it, or None and why the last does not."""
        rng = self._rng(index, attempt)
        try:
            layout = self.task.sample_layout(
                rng, variant=self.settings.variant, picks=asked.picks, places=asked.places
            )
        except PlacementError as error:
            raise PlacementError(f"{self.task.name}, scene {index:06d}: {error}") from None
        reading, reason = Reading(self.task, layout), ""
        for sentence in sentences:
            try:
                instruction = make_instruction(reading, sentence)
                target = self._draw_target(layout, instruction, asked, rng)
            except InstructionError as error:
                reason = f"{sentence.text!r}: {error}"
                continue
            return self._scene(index, attempt, layout, instruction, target), ""
        return None, reason

    def _scene(
        self, index: int, attempt: int, layout: Layout, instruction: InstructionSpec, target: Target
    ) -> SceneSpec:
        settings = self.settings
        return SceneSpec(
            task=self.task.name,
            variant=settings.variant,
            scene_id=f"{index:06d}",
            seed=SeedKey(
                root=settings.root_seed, stage=settings.stage, index=index, attempt=attempt
            ),
            split=settings.split,
            objects=layout.objects,
            places=layout.places,
            target=target,
            ambiguity=Ambiguity(picks=len(layout.pickable), places=len(layout.free_places)),
            instruction=instruction,
        )

    def _draw_target(
        self, layout: Layout, instruction: InstructionSpec, asked: Stratum, rng: np.random.Generator
    ) -> Target:
        """One of the pairs that the sentence allows, evenly, in the split and stratum asked for."""
        fitting = [
            pair
            for pair in instruction.pairs
            if asked.target_place in (None, pair[1])
            and (asked.start is None or asked.start.contains(*_start_m(layout, pair)))
            and self._in_split(layout, pair)
        ]
        if not fitting:
            raise InstructionError(
                f"none of the {len(instruction.pairs)} pairs that it allows lies in the split "
                "and stratum asked for"
            )
        pick, place = fitting[rng.integers(len(fitting))]
        return Target(pick=pick, place=place)

    def _in_split(self, layout: Layout, pair: Pair) -> bool:
        if self.settings.split in ("all", "eval"):
            return True
        splits = self.task.config.splits
        return configuration_split(splits, _start_m(layout, pair), pair[1]) == self.settings.split

    def _rng(self, index: int, attempt: int) -> np.random.Generator:
        settings = self.settings
        return rng_for(settings.root_seed, Stage[settings.stage], index, attempt)

    def _explain(self, index: int, asked: Stratum, reason: str) -> str:
        tries = ROUNDS * LAYOUTS_PER_CHOICE
        remedies = []
        if self.settings.split in ("train", "val", "held_out"):
            remedies.append(
                f"widen split {self.settings.split} by the key 'splits' of "
                f"{self.task.config_path().name}"
            )
        if self._strata:
            remedies.append(f"stratify fewer factors than {', '.join(self.settings.stratify)}")
        if asked.picks is not None or asked.places is not None:
            remedies.append("ask for more picks or places")
        remedies.append(f"change the sentence in {self.library.source}")
        return (
            f"{self.task.name}, scene {index:06d}: none of {tries} layouts fits its sentence; "
            f"last: {reason}; {', or '.join(remedies)}"
        )


def _start_m(layout: Layout, pair: Pair) -> tuple[float, float]:
    """World x and y at which the object of a pair waits."""
    x, y, _ = next(o.position_m for o in layout.pickable if o.id == pair[0])
    return x, y


def sample_scene(
    task: Task,
    *,
    root_seed: int,
    index: int,
    stage: Stage = Stage.SCENE,
    split: Split = "all",
    variant: str = "sim",
    picks: int | None = None,
    places: int | None = None,
    library: TemplateLibrary | None = None,
    template_split: TemplateSplit | None = None,
    stratify: tuple[Factor, ...] = (),
) -> SceneSpec:
    """Draw one scene; for many, a `SceneSource` does the same faster.

    Args:
        task: What to draw.
        root_seed: Seed of the whole run, >= 0.
        index: Number of the scene, >= 0; also its id.
        stage: Keeps scenes for different uses apart: `Stage.SCENE` or `Stage.EVAL_SCENE`.
        split: As in `SamplingSettings`, like all that follow but `library`.
        variant: See there.
        picks: See there.
        places: See there.
        library: Sentences; None takes those that ship.
        template_split: See there.
        stratify: See there.

    Raises:
        PlacementError: As for `SceneSource.draw`.
        InstructionError: As for `SceneSource.draw`.
        ConfigError: An argument or the library does not fit the task.
    """
    settings = SamplingSettings(
        root_seed=root_seed, stage=stage.name, variant=variant, split=split,
        template_split=template_split, picks=picks, places=places, stratify=stratify,
    )  # fmt: skip
    return SceneSource(task, settings, library).draw(index)
