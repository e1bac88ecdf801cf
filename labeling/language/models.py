"""Who writes the programs: one interface, a registry of makers, and the built-in composer.

A language model is asked for two kinds of program: one for an instruction, and one for each phrase
that the first one wants detected. What it replies is text; nothing here runs it.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from codediffuser.errors import ProgramError
from codediffuser.files import sha256_json
from codediffuser.labeling.label import Role
from codediffuser.labeling.language.checker import RESULT, ProgramKind
from codediffuser.labeling.language.composer import compose_program
from codediffuser.labeling.language.detection import compose_detection
from codediffuser.labeling.language.grammar import parse_instruction
from codediffuser.labeling.language.instances import Directions
from codediffuser.labeling.language.vocabulary import Vocabulary
from codediffuser.registry import Registry

_FENCE = re.compile(r"```[ \t]*([\w+-]*)[^\n]*\n(.*?)(?:```|\Z)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Rejected:
    """A reply that did not work, and why."""

    reply: str
    error: str


@dataclass(frozen=True, slots=True)
class Prompt:
    """What a model is asked."""

    kind: ProgramKind
    text: str
    """The instruction, or the phrase to detect."""
    categories: tuple[str, ...]
    roles: Mapping[Role, str] = field(default_factory=lambda: {"pick": "battery", "place": "slot"})
    """What `output_var` of an instruction's program holds, in the order pick, place."""
    directions: Directions = field(default_factory=Directions)
    vocabulary: Vocabulary | None = None
    """Words of the task, for the built-in composer; language models know words already."""
    rejected: tuple[Rejected, ...] = ()
    """Earlier replies to the same question, oldest first."""

    def with_rejected(self, reply: str, error: str) -> Prompt:
        """The same question, told what was wrong with the last reply."""
        return replace(self, rejected=(*self.rejected, Rejected(reply, error)))

    def as_json(self) -> dict[str, Any]:
        """Everything that a language model's reply depends on."""
        return {
            "kind": self.kind,
            "text": self.text,
            "categories": list(self.categories),
            "roles": dict(self.roles),
            "right": list(self.directions.right),
            "front": list(self.directions.front),
            "rejected": [{"reply": r.reply, "error": r.error} for r in self.rejected],
        }

    def key(self) -> str:
        """Hash by which recorded replies are found again."""
        return sha256_json(self.as_json())


class LanguageModel(ABC):
    """Replies to prompts with text that holds a program."""

    name: str
    """For records and messages."""
    repairs: bool = True
    """Whether asking again with the error can help."""

    @abstractmethod
    def reply(self, prompt: Prompt) -> str:
        """Answer one prompt.

        Raises:
            InstructionError: The model cannot make sense of the instruction.
            LanguageModelError: No answer came.
        """

    def looked_for(self, prompt: Prompt, role: Role) -> str:
        """Words for what the prompt wants in a role, for messages; may be a guess."""
        return f"the {prompt.roles[role]} that it asks for"


LANGUAGE_MODELS: Registry[Callable[..., LanguageModel]] = Registry("language model")


def get_model(name: str, **options: Any) -> LanguageModel:
    """Make a registered model.

    Args:
        name: `builtin`, `openai` or `replay`.
        options: What its maker takes: `base_url`, `model`, ... or `path`.

    Raises:
        NotRegisteredError: No such model; the message names the closest one.
    """
    from codediffuser.labeling.language import openai_model, recording  # noqa: F401  fill it

    return LANGUAGE_MODELS.get(name)(**options)


@LANGUAGE_MODELS.add("builtin")
class BuiltinComposer(LanguageModel):
    """Writes programs by grammar: no key, no network, the same text every time."""

    name = "builtin"
    repairs = False

    def reply(self, prompt: Prompt) -> str:
        """The composed program."""
        if prompt.kind == "detect":
            return compose_detection(prompt.text, prompt.categories)
        return compose_program(prompt.text, prompt.categories, prompt.directions, prompt.vocabulary)

    def looked_for(self, prompt: Prompt, role: Role) -> str:
        """The words of the instruction for that role."""
        request = parse_instruction(prompt.text, prompt.vocabulary)
        return f"'{request.pick.said if role == 'pick' else request.place.said}'"


def extract_program(reply: str) -> str:
    """Take the program out of a reply: from its fences, or the reply itself when it is bare code.

    Of several fenced blocks the last one that assigns the answer counts; a fence that is never
    closed ends with the reply.

    Raises:
        ProgramError: The reply is empty, or holds no line of code.
    """
    text = reply.replace("\r\n", "\n").strip("\n").rstrip()
    blocks = [code for language, code in _FENCE.findall(text) if _is_python(language)]
    if blocks:
        answering = [code for code in blocks if RESULT in code]
        return _tidy((answering or blocks)[-1])
    if RESULT not in text:
        start = " ".join(text[:60].split())
        raise ProgramError(
            f"the reply holds no program: {start!r}; expected Python in ``` fences that assigns "
            f"{RESULT}"
        )
    return _tidy(text)


def _is_python(language: str) -> bool:
    return language.lower() in ("", "python", "py", "python3")


def _tidy(code: str) -> str:
    """Take off what all lines are indented by, and blank lines around the code."""
    lines = code.expandtabs(4).strip("\n").rstrip().split("\n")
    indents = [len(line) - len(line.lstrip()) for line in lines if line.strip()]
    common = min(indents, default=0)
    return "\n".join(line[common:] for line in lines) + "\n"
