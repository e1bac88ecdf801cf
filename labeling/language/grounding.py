"""Instruction -> program -> targets: ask a model, check what it wrote, run it, check its answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from codediffuser.errors import InstructionError, ProgramError
from codediffuser.labeling.label import ROLES, Role
from codediffuser.labeling.language.checker import CheckedProgram, check_program
from codediffuser.labeling.language.instances import (
    Instance,
    InstanceProvider,
    describe_instances,
)
from codediffuser.labeling.language.models import LanguageModel, Prompt, extract_program, get_model
from codediffuser.labeling.language.sandbox import Limits, SceneApi, run_program
from codediffuser.registry import unknown_name

MAX_INSTRUCTION = 1_000
"""Characters of an instruction."""

MAX_DETECTIONS = 32
"""Different phrases that the programs of one instruction may ask for."""

MAX_ROUNDS = 2
"""Programs asked for per question: the first, and one repair."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ApiCall:
    """One call of a program to the scene, and what it got."""

    function: str
    arguments: tuple[str, ...]
    result: tuple[str, ...]
    """Ids of the instances, in order."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One reply of the model, and how it fared."""

    kind: str
    text: str
    """The instruction, or the phrase to detect."""
    reply: str
    error: str | None


@dataclass(frozen=True, slots=True)
class Grounding:
    """What an instruction means in a scene, and how that was found."""

    instruction: str
    model: str
    program: str
    """Program that gave the answer, as the model wrote it."""
    targets: tuple[tuple[Role, str], ...]
    """(role, instance id): pick, then place."""
    calls: tuple[ApiCall, ...] = ()
    attempts: tuple[Attempt, ...] = ()

    def target(self, role: Role) -> str:
        """Instance id of a role."""
        return dict(self.targets)[role]

    def as_json(self) -> dict[str, Any]:
        """Plain data for result files."""
        return {
            "instruction": self.instruction,
            "model": self.model,
            "program": self.program,
            "targets": dict(self.targets),
            "calls": [
                {"function": c.function, "arguments": list(c.arguments), "result": list(c.result)}
                for c in self.calls
            ],
            "attempts": [
                {"kind": a.kind, "text": a.text, "reply": a.reply, "error": a.error}
                for a in self.attempts
            ],
        }


def ground(
    instruction: str,
    provider: InstanceProvider,
    model: LanguageModel | str = "builtin",
    *,
    limits: Limits | None = None,
) -> Grounding:
    """Find the object to pick and the place to put it at.

    Args:
        instruction: What a person says.
        provider: The scene's instances.
        model: Who writes the programs, or its registered name.
        limits: Of each program; None takes the defaults.

    Raises:
        InstructionError: The instruction is not understood, or fits nothing in the scene; the
            message says what was looked for and what there is.
        ProgramError: The model's programs are not allowed, fail, or answer with no targets.
        LanguageModelError: The model does not answer.
        NotRegisteredError: No model has this name.
    """
    instruction = instruction.strip()
    if not 0 < len(instruction) <= MAX_INSTRUCTION:
        raise InstructionError(
            f"expected an instruction of 1 to {MAX_INSTRUCTION} characters, got {len(instruction)}"
        )
    chosen = get_model(model) if isinstance(model, str) else model
    return _Grounder(instruction, provider, chosen, limits or Limits()).ground()


@dataclass(slots=True)
class _Grounder:
    """One instruction's way from words to targets."""

    instruction: str
    provider: InstanceProvider
    model: LanguageModel
    limits: Limits
    calls: list[ApiCall] = field(default_factory=list)
    attempts: list[Attempt] = field(default_factory=list)
    detected: dict[str, tuple[Instance, ...]] = field(default_factory=dict)

    def ground(self) -> Grounding:
        """Ask for the program, run it, judge the answer."""
        prompt = self._prompt("compose", self.instruction)
        program, targets = self._solve(prompt, self._targets)
        missing = [role for role, target in zip(ROLES, targets, strict=True) if target is None]
        if missing:
            words = " and ".join(self.model.looked_for(prompt, role) for role in missing)
            raise InstructionError(
                f"{self.instruction!r} fits nothing in the scene: looked for {words}; there are "
                f"{describe_instances(self.provider)}"
            )
        return Grounding(
            instruction=self.instruction,
            model=self.model.name,
            program=program.text,
            targets=tuple((r, t.id) for r, t in zip(ROLES, targets, strict=True) if t is not None),
            calls=tuple(self.calls),
            attempts=tuple(self.attempts),
        )

    def _prompt(self, kind: Any, text: str) -> Prompt:
        provider = self.provider
        return Prompt(
            kind,
            text,
            tuple(provider.categories),
            provider.roles,
            provider.directions,
            provider.vocabulary,
        )

    def _solve(
        self, prompt: Prompt, judge: Callable[[CheckedProgram], T]
    ) -> tuple[CheckedProgram, T]:
        """Ask until a program passes and its answer is accepted, at most `MAX_ROUNDS` times."""
        for round_ in range(MAX_ROUNDS):
            reply = self.model.reply(prompt)
            try:
                program = check_program(extract_program(reply), prompt.kind)
                result = judge(program)
            except ProgramError as error:
                self.attempts.append(Attempt(prompt.kind, prompt.text, reply, str(error)))
                if not self.model.repairs or round_ + 1 == MAX_ROUNDS:
                    raise ProgramError(f"{prompt.kind} {prompt.text!r}: {error}") from None
                prompt = prompt.with_rejected(reply, str(error))
            else:
                self.attempts.append(Attempt(prompt.kind, prompt.text, reply, None))
                return program, result
        raise AssertionError("the last round returns or raises")

    def _targets(self, program: CheckedProgram) -> list[Instance | None]:
        """Run an instruction's program; one instance, or None, for each role in order."""
        found = self._run(program)
        if len(found) != len(ROLES):
            raise ProgramError(
                f"output_var: expected [pick, place], got a list of {len(found)} items"
            )
        for role, item in zip(ROLES, found, strict=True):
            wanted = self.provider.roles[role]
            if item is not None and item.category != wanted:
                raise ProgramError(
                    f"output_var: expected a {wanted} to {role}, got a {item.category}; "
                    "the order is [pick, place]"
                )
        return found

    def _run(self, program: CheckedProgram) -> list[Instance | None]:
        api = SceneApi(self._detect, self._get_obj, self._find)
        began = len(self.calls)
        try:
            return run_program(program, api, self.limits)
        except ProgramError as error:
            empty = [c.arguments[0] for c in self.calls[began:] if not c.result]
            if empty:
                hint = ", ".join(f'"{phrase}"' for phrase in dict.fromkeys(empty))
                raise ProgramError(f"{error} (nothing was found for {hint})") from None
            raise

    def _detect(self, phrase: str) -> Sequence[Instance]:
        """Serve `self.detect`: a second program finds what the phrase names."""
        phrase = phrase.strip()
        if phrase not in self.detected:
            if len(self.detected) >= MAX_DETECTIONS:
                raise ProgramError(f"a program may detect at most {MAX_DETECTIONS} phrases")
            _, found = self._solve(self._prompt("detect", phrase), self._run)
            self.detected[phrase] = tuple(item for item in found if item is not None)
        return self._traced("detect", (phrase,), self.detected[phrase])

    def _get_obj(self, category: str) -> Sequence[Instance]:
        self._check_category(category)
        return self._traced("get_obj", (category,), self.provider.instances(category))

    def _find(self, phrase: str, category: str) -> list[int]:
        self._check_category(category)
        indices = self.provider.find_instance_in_category(phrase, category)
        instances = self.provider.instances(category)
        found = [instances[index] for index in indices]
        self._traced("find_instance_in_category", (phrase, category), found)
        return indices

    def _check_category(self, category: str) -> None:
        if category not in self.provider.categories:
            raise ProgramError(unknown_name("category", category, list(self.provider.categories)))

    def _traced(
        self, function: str, arguments: tuple[str, ...], found: Sequence[Instance]
    ) -> Sequence[Instance]:
        self.calls.append(ApiCall(function, arguments, tuple(item.id for item in found)))
        return found
