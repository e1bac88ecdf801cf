"""The template library: which sentences there are, and which placeholders each may hold."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from codediffuser.errors import ConfigError
from codediffuser.registry import unknown_name
from codediffuser.schema import Document, Strict

LIBRARY_PATH = Path(__file__).parent / "instruction_templates.yaml"
OTHER = "other_"
"""Prefix of placeholders for what is mentioned but not meant."""


class TaskSentences(Strict):
    """Phrases and sentences of one task, as in the YAML."""

    components: dict[str, tuple[str, ...]]
    """Category (that is, placeholder) to the phrases that may fill it: picks first, then places."""
    templates: dict[str, tuple[str, ...]]
    """Slackness kind to its sentences."""


class TemplateFile(Document):
    """A file of templates (`schema: codediffuser.instruction_templates/1`)."""

    KIND: ClassVar[str] = "instruction_templates"
    VERSION: ClassVar[int] = 1

    tasks: dict[str, TaskSentences]


@dataclass(frozen=True, slots=True)
class Template:
    """One sentence with placeholders."""

    id: str
    """`<task>/<kind>/<number>`, counted from 0."""
    kind: str
    text: str
    placeholders: tuple[str, ...]
    """Each once, in the order of the sentence."""

    def fill(self, words: dict[str, str]) -> str:
        """Put words in the place of every placeholder."""
        return re.sub(r"\{(\w+)\}", lambda match: words[match[1]], self.text)


@dataclass(frozen=True, slots=True)
class TemplateLibrary:
    """What can be said about one task."""

    task: str
    source: Path
    """The file it came from, for messages."""
    phrases: dict[str, tuple[str, ...]]
    """Category to the phrases that may fill its placeholder."""
    templates: tuple[Template, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Slackness kinds in the order of the file."""
        return tuple(dict.fromkeys(template.kind for template in self.templates))


@functools.cache
def load_templates(task: str, path: Path = LIBRARY_PATH) -> TemplateLibrary:
    """Read and check what a template file says about a task.

    Raises:
        ConfigError: The file is unreadable, lacks the task, or a sentence has a placeholder that
            is unknown or that its kind forbids; the message gives file, key and placeholder.
    """
    file = TemplateFile.load(path)
    if task not in file.tasks:
        raise ConfigError(f"{path}: {unknown_name('task', task, sorted(file.tasks))}")
    sentences = file.tasks[task]
    where = f"{path}: key 'tasks.{task}"
    if len(sentences.components) != 2 or not all(sentences.components.values()):
        raise ConfigError(
            f"{where}.components': expected two categories, what is picked and where it goes, each "
            f"with phrases; got {', '.join(sentences.components) or 'none'}"
        )
    named = _categories_by_kind(tuple(sentences.components))
    templates = []
    for kind, texts in sentences.templates.items():
        if kind not in named:
            raise ConfigError(f"{where}.templates': {unknown_name('kind', kind, list(named))}")
        for number, text in enumerate(texts):
            placeholders = _placeholders(text, named, kind, f"{where}.templates.{kind}.{number}'")
            templates.append(Template(f"{task}/{kind}/{number}", kind, text, placeholders))
    if not templates:
        raise ConfigError(f"{where}.templates': expected at least one sentence, got none")
    return TemplateLibrary(task, path, dict(sentences.components), tuple(templates))


def _categories_by_kind(categories: tuple[str, ...]) -> dict[str, frozenset[str]]:
    """Slackness kind to the categories that its sentences must name."""
    named = {"no_slackness": frozenset(categories), "both_slackness": frozenset[str]()}
    for category in categories:
        named[f"{category}_slackness"] = frozenset(categories) - {category}
    return named


def _placeholders(
    text: str, named: dict[str, frozenset[str]], kind: str, where: str
) -> tuple[str, ...]:
    """Placeholders of a sentence, checked: known ones, and those that its kind calls for."""
    found = tuple(dict.fromkeys(re.findall(r"\{([^{}]*)\}", text)))
    if "{" in re.sub(r"\{[^{}]*\}", "", text) or "}" in re.sub(r"\{[^{}]*\}", "", text):
        raise ConfigError(f"{where}: a brace is not closed or not opened in {text!r}")
    known = [prefix + c for c in sorted(named["no_slackness"]) for prefix in ("", OTHER)]
    for placeholder in found:
        if placeholder not in known:
            raise ConfigError(f"{where}: {unknown_name('placeholder', placeholder, known)}")
    categories = {placeholder.removeprefix(OTHER) for placeholder in found}
    if categories != named[kind]:
        wanted = " and ".join(f"{{{c}}}" for c in sorted(named[kind])) or "no placeholder"
        got = ", ".join(f"{{{p}}}" for p in found) or "none"
        raise ConfigError(f"{where}: a sentence of kind {kind} names {wanted}, got {got}")
    return found
