"""The words of the instruction language, each with what it does in the grammar.

To teach a word, add it to one of the tables. A word in none of them is an error that names it:
guessing at an unknown word could send the robot to the wrong place.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from enum import Enum, auto

from codediffuser.errors import InstructionError
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
    """Adjectives that choose nothing here, since only free slots and waiting batteries count."""
    NUMBER = auto()
    """More than one: may be talked about, but not moved."""
    BATTERY = auto()
    SLOT = auto()
    REGION = auto()
    AREA = auto()
    CONTAINER = auto()
    SURFACE = auto()
    PERSON = auto()
    PRONOUN = auto()
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
    Kind.THE: "the that this these those my our your",
    Kind.ONE: "one ones",
    Kind.OTHER: "other another different",
    Kind.LOOK: (
        "red green blue purple violet yellow orange black white grey gray brown pink silver gold"
    ),
    Kind.STATE: (
        "free empty open available unoccupied vacant unused loose waiting unpacked single lone "
        "only remaining possible suitable very messy tidy clean cluttered untidy ready"
    ),
    Kind.NUMBER: "two three four five several few many both all every each",
    Kind.BATTERY: "battery batteries",
    Kind.SLOT: "slot slots compartment compartments hole holes cell cells spot spots",
    Kind.REGION: "row rows column columns",
    Kind.AREA: "side sides end edge corner part area",
    Kind.CONTAINER: "crate box tray container case",
    Kind.SURFACE: "table desk tabletop pad workspace bench",
    Kind.PERSON: "robot you me us yourself observer arm gripper",
    Kind.PRONOUN: "it them itself",
    Kind.INTO: "in into inside within onto on to at",
    Kind.OF: "of from along away",
    Kind.OUTSIDE: "outside beside off",
    Kind.BE: "is are be was were sits sit stands stand lies lie which who",
    Kind.MOVE: (
        "put place pick move drop insert pack stow take grab transfer bring set store load stick "
        "pop slide lift carry deposit go belong fill choose select get fetch return clear shift "
        "touch"
    ),
    Kind.USE: "use need",
    Kind.KEEP: "keep leave save reserve spare skip avoid ignore",
    Kind.NOT: "not never",
    Kind.EXCEPT: "except excluding besides",
    Kind.CORRECTION: "sorry oops correction actually rather wait mean meant scratch",
    Kind.THERE: "there",
    Kind.FILLER: (
        "i we he she they please could can would will should shall must may might do does did "
        "want wants like likes have has let lets just start starting begin now then first also so "
        "and or but with by for up down away too more make makes making oh hey hi hello ok okay "
        "thanks thank kindly as well today soon quickly carefully gently here what "
        "everything something anything going instead because mind"
    ),
}  # fmt: skip

_SIDES: dict[Side, str] = {
    "left": "left leftmost",
    "right": "right rightmost",
    "front": "front frontmost foremost",
    "back": "back backmost rear rearmost hindmost",
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

CAN_SAY = (
    "batteries (left-most, right-most, front-most, back-most, middle, or by colour), slots "
    "(nearest, furthest, or by front, middle, back row and left, middle, right column), 'a' for "
    "any, 'I need to use X' for what must stay, 'sorry, Y' for a correction, 'the other one'"
)
"""What error messages offer."""


@dataclass(frozen=True, slots=True)
class Token:
    """One word or stop, in lower case."""

    text: str
    kind: Kind


_REWRITES = (
    (r"[’`]", "'"),
    (r"\b(can't|cant|cannot)\b", "can not"),
    (r"\bwon'?t\b", "will not"),
    (r"\b(do|does|did|should|would|is|are|was)n'?t\b", r"\1 not"),
    (r"\b(that|there|it|here|what)'s\b", r"\1 is"),
    (r"\blet's\b", "let us"),
    (r"'(d|ll|m|re|ve)\b", " "),
    (r"'s\b", " "),
    (r"\b(left|right|front|back|rear|near|far|middle|hind)[\s-]*most\b", r"\1most"),
    (r"\bmost (left|right)\b", r"\1most"),
    (r"\b(left|right)[\s-]hand\b", r"\1"),
    (r"\bright (away|now)\b", "now"),
    (r"\bmost distant\b", "furthest"),
    (r"\bout of\b", "outside"),
    (r"\bin front of\b", "outside"),
    (r"\bnext to\b", "beside"),
    (r"\bother than\b", "except"),
    (r"\b(instead of|apart from|rather than)\b", "except"),
    (r"\bmake that\b", "sorry"),
    (r"(^|[.!?;,]\s*|\boh\s+)no\b", r"\1 sorry"),
    (r"-", " "),
)  # fmt: skip


def tokenize(text: str) -> list[Token]:
    """Split an instruction into known words and stops.

    Raises:
        InstructionError: It is empty, or has a word that no table knows; the message names the
            word, the closest known one, and what can be said.
    """
    plain = text.lower()
    for pattern, replacement in _REWRITES:
        plain = re.sub(pattern, replacement, plain)
    tokens = []
    for part in re.findall(r"[\w']+|[.!?;:]|,|[^\s\w]", plain):
        if part in ".!?;:":
            tokens.append(Token(part, Kind.STOP))
        elif part == ",":
            tokens.append(Token(part, Kind.COMMA))
        elif part in KINDS:
            tokens.append(Token(part, KINDS[part]))
        elif (verb := _base_form(part)) is not None:
            tokens.append(Token(part, KINDS[verb]))
        elif re.search(r"\w", part):
            raise InstructionError(unknown_word(part, text))
    if not any(token.kind not in (Kind.STOP, Kind.COMMA) for token in tokens):
        raise InstructionError(f"the instruction is empty: {text!r}; I understand {CAN_SAY}")
    return tokens


def _base_form(word: str) -> str | None:
    """The known verb that `word` is a form of: `putting`, `places`, `dropped`."""
    verbs = (Kind.MOVE, Kind.USE, Kind.KEEP)
    for ending in ("ing", "ed", "es", "s"):
        stem = word.removesuffix(ending)
        if stem != word and len(stem) > 1:
            for base in (stem, stem + "e", stem[:-1] if stem[-1] == stem[-2] else stem):
                if KINDS.get(base) in verbs:
                    return base
    return None


def unknown_word(word: str, text: str) -> str:
    """Say which word is not understood, and what would be."""
    close = difflib.get_close_matches(word, sorted(KINDS), n=1, cutoff=0.75)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    return f"the word '{word}'{hint} is not understood in {text!r}; I understand {CAN_SAY}"
