"""The key `words` of a task's YAML: how people speak of its things and places.

What the built-in composer has to know of a task to turn instructions into programs; nothing here is
needed to draw scenes or to teach a policy.
"""

from __future__ import annotations

from pydantic import Field, PositiveFloat, PositiveInt

from codediffuser.schema import Strict


class GridConfig(Strict):
    """Places lie in rows and columns of their holder."""

    x: PositiveInt
    """How many places lie beside each other along the world's x."""
    y: PositiveInt


class WordsConfig(Strict):
    """Nouns of a task, and by what its places are told apart."""

    nouns: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    """Category to its words, first the usual one, the plurals last. A category that is left out is
    called by its own name and that with an s."""
    holder: str | None = None
    """Category of the one thing that all places belong to: `crate`. What lies within its outline
    takes a place already and does not wait to be picked."""
    grid: GridConfig | None = None
    """For `the back row`, `the left column`."""
    level_m: PositiveFloat | None = None
    """For `top` and `middle` places: how far a place lies below the highest one when it is no
    longer at the top."""
    neighbours: bool = False
    """Whether places are told by the things beside them: `right next to COMET on its left side`,
    `between TIGER and the blue book`."""
    titles: bool = False
    """Whether things bear titles. In capitals, in quotes, or capitalised and otherwise unknown, a
    word is one."""
