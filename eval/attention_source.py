"""Who decides what the policy attends to: the scene's own target, or the instruction."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from codediffuser.datagen.scene import Pair, SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.errors import (
    CodeDiffuserError,
    InstructionError,
    LanguageModelError,
    ProgramError,
)
from codediffuser.eval.results import AttentionFrom
from codediffuser.labeling.label import Role
from codediffuser.labeling.language import (
    LanguageModel,
    Limits,
    Prompt,
    get_model,
    ground,
    simulated_provider,
)

FAILURES: tuple[tuple[type[CodeDiffuserError], str], ...] = (
    (InstructionError, "language:fits_nothing"),
    (ProgramError, "language:program"),
    (LanguageModelError, "language:no_answer"),
)
"""What words that lead nowhere are counted as."""

LIMITS = Limits(seconds=10.0)
"""A program takes milliseconds; the margin keeps results the same on a machine that is busy."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A pair of targets and how it was come by, or why there is none."""

    pair: Pair | None
    program: str | None = None
    """What the language model wrote; None where none was asked or none answered."""
    seconds: float = 0.0
    failure: str = ""
    """`language:...` when there is no pair."""
    detail: str = ""


class AttentionSource(Protocol):
    """Chooses targets for a scene as it was reset."""

    def choose(self, task: Task, scene: SceneSpec) -> Choice:
        """Choose an object and a place; words that lead nowhere are a choice with a failure."""

    def judged_pairs(self, scene: SceneSpec) -> Sequence[Pair]:
        """Pairs that count as a success, given what the policy was told."""


class OracleSource:
    """The target that the scene was made with: measures motion alone."""

    def choose(self, task: Task, scene: SceneSpec) -> Choice:
        """Read the target off the scene."""
        return Choice(pair=(scene.target.pick, scene.target.place))

    def judged_pairs(self, scene: SceneSpec) -> Sequence[Pair]:
        """Only that target: the policy was told exactly what to do."""
        return [(scene.target.pick, scene.target.place)]


class LanguageSource:
    """The instruction alone, by way of a program on the simulator's instances.

    Args:
        model: Who writes the program; None takes the built-in composer.
    """

    def __init__(self, model: LanguageModel | None = None) -> None:
        self._model = model or get_model("builtin")

    def choose(self, task: Task, scene: SceneSpec) -> Choice:
        """Ground the instruction.

        The target of the scene is not looked at: only its objects, its free places and the words.
        """
        listener = _Listener(self._model)
        begun = time.perf_counter()
        try:
            provider = simulated_provider(scene, task=task)
            found = ground(scene.instruction.text, provider, listener, limits=LIMITS)
        except tuple(kind for kind, _ in FAILURES) as error:
            return Choice(
                pair=None,
                program=listener.program,
                seconds=time.perf_counter() - begun,
                failure=next(name for kind, name in FAILURES if isinstance(error, kind)),
                detail=str(error),
            )
        pair = (found.target("pick"), found.target("place"))
        return Choice(pair, found.program, time.perf_counter() - begun)

    def judged_pairs(self, scene: SceneSpec) -> Sequence[Pair]:
        """Every pair that the instruction allows."""
        return scene.instruction.pairs


def source_for(attention: AttentionFrom, language_model: str | None = None) -> AttentionSource:
    """Build the source of that name.

    Args:
        attention: Who chooses.
        language_model: Registered name of the model for `language`; None takes the built-in one.

    Raises:
        NotRegisteredError: No such model.
        SetupError: The model lacks its key.
    """
    if attention == "oracle":
        return OracleSource()
    return LanguageSource(get_model(language_model or "builtin"))


class _Listener(LanguageModel):
    """Passes prompts on and remembers what was written, even when it leads nowhere."""

    name = "listener"

    def __init__(self, inner: LanguageModel) -> None:
        self._inner = inner
        self.program: str | None = None
        """The last reply to an instruction."""

    @property
    def repairs(self) -> bool:  # type: ignore[override]
        """As the inner model."""
        return self._inner.repairs

    def reply(self, prompt: Prompt) -> str:
        """The inner model's reply."""
        text = self._inner.reply(prompt)
        if prompt.kind == "compose":
            self.program = text
        return text

    def looked_for(self, prompt: Prompt, role: Role) -> str:
        """The inner model's words."""
        return self._inner.looked_for(prompt, role)
