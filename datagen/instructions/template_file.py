"""Template files as people write them; `templates.py` makes a checked library of one."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from codediffuser.schema import Document, Strict

LIBRARY_PATH = Path(__file__).parent / "instruction_templates.yaml"
"""The sentences that ship."""


class UnseenSentence(Strict):
    """`- unseen: "..."` in the place of a plain sentence."""

    unseen: str


class KindSpec(Strict):
    """What the sentences of one slackness kind say."""

    names: tuple[str, ...] = ()
    """Categories that every sentence of the kind names."""
    may_name: tuple[str, ...] = ()
    """Categories that a sentence of the kind may name or leave out."""


class TaskSentences(Strict):
    """Phrases and sentences of one task, as in the YAML."""

    components: dict[str, tuple[str, ...]]
    """Category (that is, placeholder) to the phrases that may fill it: what is picked comes first,
    all others say where it goes. `*` in a phrase stands for any words."""
    kinds: dict[str, KindSpec] | None = None
    """Slackness kinds; None is allowed for two categories and gives the four kinds of the paper."""
    templates: dict[str, tuple[str | UnseenSentence, ...]]
    """Slackness kind to its sentences."""


class TemplateFile(Document):
    """A file of templates (`schema: codediffuser.instruction_templates/1`)."""

    KIND: ClassVar[str] = "instruction_templates"
    VERSION: ClassVar[int] = 1

    tasks: dict[str, TaskSentences]
