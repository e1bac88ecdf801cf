"""What reading an instruction has found so far: in all of it, and in the clause that is read."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from codediffuser.labeling.language.meaning import Description


class Mood(Enum):
    """What a phrase means in its clause."""

    MOVE = auto()
    STAY = auto()
    MENTION = auto()


@dataclass(slots=True)
class State:
    """What has been understood so far."""

    targets: dict[str, Description] = field(default_factory=dict)
    """Category to what is meant, for what is picked and for its place."""
    excluded: list[Description] = field(default_factory=list)
    last: dict[str, tuple[Mood, Description]] = field(default_factory=dict)
    """Category to its last mention, for corrections and pronouns."""
    last_category: str = ""
    holder: str = ""
    """Words by which the place is given only as what all places belong to; empty if it is not."""


@dataclass(slots=True)
class Clause:
    """What the words since the last verb or stop have set."""

    mood: Mood = Mood.MOVE
    verb: bool = False
    negated: bool = False
    speaker: bool = False
    """Whether `I` or `we` is the subject."""
    selects: bool = False
    """Whether the verb only narrows what was said: `use the nearest one`."""
    into: bool = False
    """Whether a preposition of place comes right before."""
    leaves_out: bool = False
    """Whether the next phrase comes after `except`."""
    correcting: bool = False
    corrected: set[str] = field(default_factory=set)
    named: set[str] = field(default_factory=set)
    """Categories that this sentence has named as targets."""
