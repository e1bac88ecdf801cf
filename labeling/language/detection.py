"""Write the program that detects what a phrase of another program names."""

from __future__ import annotations

import re
from collections.abc import Sequence

from codediffuser.errors import InstructionError


def compose_detection(phrase: str, categories: Sequence[str]) -> str:
    """Write the program that finds what a phrase names: all of a category, or those that look so.

    Raises:
        InstructionError: The phrase names none of the categories, or more than one.
    """
    words = re.findall(r"[\w']+", phrase.lower())
    whole = [c for c in categories if c == " ".join(words)]
    named = whole or [c for c in categories if {c, f"{c}s", f"{c[:-1]}ies"} & set(words)]
    if len(named) != 1:
        raise InstructionError(
            f"the phrase {phrase!r} should name one category of {', '.join(categories)}"
        )
    category = named[0]
    lines = [f'{variable(category)}_list = self.get_obj("{category}")']
    if whole or len(words) == 1:
        return "\n".join([*lines, f"output_var = {variable(category)}_list", ""])
    quoted = " ".join(words)
    lines += [
        f'indices = self.find_instance_in_category(instance="{quoted}", category="{category}")',
        f"output_var = [{variable(category)}_list[i] for i in indices]",
        "",
    ]
    return "\n".join(lines)


def variable(words: str) -> str:
    """A name for programs, made of words: `lost kingdoms` -> `lost_kingdoms`."""
    name = re.sub(r"\W+", "_", words.lower()).strip("_")
    return name if name[:1].isalpha() else f"named_{name}"
