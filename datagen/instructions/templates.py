"""The template library: which sentences there are, and which placeholders each may hold."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from codediffuser.datagen.instructions.template_file import (
    LIBRARY_PATH,
    KindSpec,
    TaskSentences,
    TemplateFile,
    UnseenSentence,
)
from codediffuser.datagen.scene import TemplateSplit
from codediffuser.errors import ConfigError
from codediffuser.registry import unknown_name

OTHER = "other_"
"""Prefix of placeholders for what is mentioned but not meant."""


@dataclass(frozen=True, slots=True)
class Template:
    """One sentence with placeholders."""

    id: str
    """`<task>/<kind>/<number>`, counted from 0."""
    kind: str
    text: str
    placeholders: tuple[str, ...]
    """Each once, in the order of the sentence."""
    split: TemplateSplit = "seen"

    def fill(self, words: Mapping[str, str]) -> str:
        """Put words in the place of placeholders; those that begin a sentence are capitalised."""

        def put(match: re.Match[str]) -> str:
            chosen = words[match[2]]
            begins = match.start() == 0 or match[1]
            return match[1] + (chosen[0].upper() + chosen[1:] if begins else chosen)

        return re.sub(r"((?:[.!?] )?)\{(\w+)\}", put, self.text)


@dataclass(frozen=True, slots=True)
class TemplateLibrary:
    """What can be said about one task."""

    task: str
    source: Path
    """The file it came from, for messages."""
    phrases: Mapping[str, tuple[str, ...]]
    """Category to the phrases that may fill its placeholder, `*` standing for any words."""
    templates: tuple[Template, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Slackness kinds in the order of the file."""
        return tuple(dict.fromkeys(template.kind for template in self.templates))

    def only(self, split: TemplateSplit | None) -> TemplateLibrary:
        """The library with the sentences of one split; None keeps all.

        Raises:
            ConfigError: No sentence is left.
        """
        if split is None:
            return self
        kept = tuple(template for template in self.templates if template.split == split)
        if not kept:
            raise ConfigError(
                f"{self.source}: key 'tasks.{self.task}.templates': no sentence is {split}; "
                "write some as '- unseen: \"...\"' and the others plainly"
            )
        return replace(self, templates=kept)


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
    kinds = _kinds(sentences, where)
    templates = []
    for kind, entries in sentences.templates.items():
        if kind not in kinds:
            raise ConfigError(f"{where}.templates': {unknown_name('kind', kind, list(kinds))}")
        for number, entry in enumerate(entries):
            text = entry.unseen if isinstance(entry, UnseenSentence) else entry
            placeholders = _placeholders(
                text, kind, kinds[kind], tuple(sentences.components),
                f"{where}.templates.{kind}.{number}'",
            )  # fmt: skip
            split: TemplateSplit = "unseen" if isinstance(entry, UnseenSentence) else "seen"
            templates.append(Template(f"{task}/{kind}/{number}", kind, text, placeholders, split))
    if not templates:
        raise ConfigError(f"{where}.templates': expected at least one sentence, got none")
    return TemplateLibrary(task, path, sentences.components, tuple(templates))


def _kinds(sentences: TaskSentences, where: str) -> Mapping[str, KindSpec]:
    """The kinds that a file declares, checked, or the paper's four for two categories."""
    categories = tuple(sentences.components)
    if sentences.kinds is None:
        if len(categories) != 2 or not all(sentences.components.values()):
            raise ConfigError(
                f"{where}.components': expected two categories, what is picked and where it goes, "
                f"each with phrases; got {', '.join(categories) or 'none'} (for others, say under "
                "'kinds' what each kind names)"
            )
        pick, place = categories
        return {
            "no_slackness": KindSpec(names=(pick, place)),
            f"{pick}_slackness": KindSpec(names=(place,)),
            f"{place}_slackness": KindSpec(names=(pick,)),
            "both_slackness": KindSpec(),
        }
    for kind, spec in sentences.kinds.items():
        for category in (*spec.names, *spec.may_name):
            if category not in categories:
                raise ConfigError(
                    f"{where}.kinds.{kind}': {unknown_name('category', category, list(categories))}"
                )
    return sentences.kinds


def _placeholders(
    text: str, kind: str, spec: KindSpec, categories: tuple[str, ...], where: str
) -> tuple[str, ...]:
    """Placeholders of a sentence, checked: known ones, and those that its kind calls for."""
    found = tuple(dict.fromkeys(re.findall(r"\{([^{}]*)\}", text)))
    if "{" in re.sub(r"\{[^{}]*\}", "", text) or "}" in re.sub(r"\{[^{}]*\}", "", text):
        raise ConfigError(f"{where}: a brace is not closed or not opened in {text!r}")
    known = [prefix + c for c in sorted(categories) for prefix in ("", OTHER)]
    for placeholder in found:
        if placeholder not in known:
            raise ConfigError(f"{where}: {unknown_name('placeholder', placeholder, known)}")
    named = {placeholder.removeprefix(OTHER) for placeholder in found}
    if not set(spec.names) <= named <= {*spec.names, *spec.may_name}:
        wanted = " and ".join(f"{{{c}}}" for c in sorted(spec.names)) or "no placeholder"
        optional = "".join(f", and may name {{{c}}}" for c in sorted(spec.may_name))
        got = ", ".join(f"{{{p}}}" for p in found) or "none"
        raise ConfigError(f"{where}: a sentence of kind {kind} names {wanted}{optional}, got {got}")
    return found
