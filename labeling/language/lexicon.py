"""The words of the instruction language, each with what it does in the grammar.

Nouns come from the task (`vocabulary`), all other words from these tables. To teach a word, add it
to one of them. A word in none is an error that names it: guessing at an unknown word could send the
robot to the wrong place.
"""

from __future__ import annotations

from enum import Enum, auto

from codediffuser.labeling.language.meaning import DistanceKind, Side


class Kind(Enum):
    """What a word does."""

    ANY = auto()
    THE = auto()
    ONE = auto()
    OTHER = auto()
    SIDE = auto()
    DISTANCE = auto()
    LOOK = auto()
    STATE = auto()
    """Adjectives that choose nothing here, since only free places and waiting things count."""
    NUMBER = auto()
    """More than one: may be talked about, but not moved."""
    PICK = auto()
    """Nouns for what is picked."""
    PLACE = auto()
    """Nouns for what it is placed at."""
    TITLE = auto()
    """What is written on one thing."""
    REGION = auto()
    AREA = auto()
    CONTAINER = auto()
    """Nouns for what the places belong to."""
    SURFACE = auto()
    PERSON = auto()
    PRONOUN = auto()
    ASIDE = auto()
    """Nouns that an instruction may mention, but that nothing is done with."""
    BESIDE = auto()
    BETWEEN = auto()
    INTO = auto()
    OF = auto()
    OUTSIDE = auto()
    BE = auto()
    MOVE = auto()
    USE = auto()
    KEEP = auto()
    NOT = auto()
    EXCEPT = auto()
    CORRECTION = auto()
    THERE = auto()
    FILLER = auto()
    COMMA = auto()
    STOP = auto()


_WORDS: dict[Kind, str] = {
    Kind.ANY: "a an any some either whichever",
    Kind.THE: "the that this these those my our your its",
    Kind.ONE: "one ones",
    Kind.OTHER: "other another different",
    Kind.LOOK: (
        "red green blue purple violet yellow orange black white grey gray brown pink silver gold "
        "beige"
    ),
    Kind.STATE: (
        "free empty open available unoccupied vacant unused loose waiting unpacked single lone "
        "only remaining possible suitable very exact same messy tidy clean cluttered untidy ready"
    ),
    Kind.NUMBER: "two three four five several few many both all every each",
    Kind.REGION: "row rows column columns",
    Kind.AREA: "side sides end edge corner part area",
    Kind.SURFACE: "table desk tabletop pad workspace bench",
    Kind.PERSON: "robot you me us yourself observer arm gripper",
    Kind.PRONOUN: "it them itself",
    Kind.ASIDE: "water coffee tea subject way stretch mess order time friend",
    Kind.INTO: "in into inside within onto on to at",
    Kind.OF: "of from along away",
    Kind.OUTSIDE: "outside beside off",
    Kind.BE: "is are be was were sits sit stands stand lies lie which who",
    Kind.MOVE: (
        "put place pick move drop insert pack stow take grab transfer bring set store load stick "
        "pop slide lift carry deposit go belong fill choose select get fetch return clear shift "
        "touch hang shelve tuck squeeze push add find"
    ),
    Kind.USE: "use need",
    Kind.KEEP: "keep leave save reserve spare skip avoid ignore",
    Kind.BESIDE: "adjacent",
    Kind.BETWEEN: "between",
    Kind.NOT: "not never thought",
    Kind.EXCEPT: "except excluding besides",
    Kind.CORRECTION: "sorry oops correction actually rather wait mean meant scratch",
    Kind.THERE: "there",
    Kind.FILLER: (
        "i we he she they please could can would will should shall must may might do does did "
        "want wants like likes have has let lets just start starting begin now then first also so "
        "and or but with by for up down away too more make makes making oh hey hi hello ok okay "
        "thanks thank kindly as well today soon quickly carefully gently here what "
        "everything something anything going instead because mind "
        "someone somebody somewhere anywhere am drink drinking finished reading forgot forgotten "
        "ensure sure ends sorted sort about before after took again long matter disappear live "
        "lives where see done standing fine out"
    ),
}  # fmt: skip

_SIDES: dict[Side, str] = {
    "left": "left leftmost",
    "right": "right rightmost",
    "front": "front frontmost foremost",
    "back": "back backmost rear rearmost hindmost",
    "top": "top topmost upper uppermost highest",
    "bottom": "bottom bottommost lowest",
    "middle": "middle center centre central centermost middlemost",
}
_DISTANCES: dict[DistanceKind, str] = {
    "nearest": "nearest closest nearmost near close closer nearer",
    "furthest": "furthest farthest furthermost farmost far",
}

KINDS: dict[str, Kind] = {}
for _kind, _text in _WORDS.items():
    for _word in _text.split():
        KINDS.setdefault(_word, _kind)
SIDES = {word: side for side, text in _SIDES.items() for word in text.split()}
DISTANCES = {word: kind for kind, text in _DISTANCES.items() for word in text.split()}
KINDS.update(dict.fromkeys(SIDES, Kind.SIDE))
KINDS.update(dict.fromkeys(DISTANCES, Kind.DISTANCE))
