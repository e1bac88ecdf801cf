"""Understand an instruction of the pack-battery language: what to pick, where to place it.

    instruction = sentence {stop sentence}
    sentence    = {verb | preposition | filler | phrase | correction}

Verbs set what the phrases after them mean: with `put`, `take`, ... they name what to move and where
to; with `keep`, or with `use` and `need` of the speaker's own (`I need to use X`), what must stay;
after `there are` they only introduce. `sorry` and its like make the next phrase replace the last
one of its kind. Which role a phrase has follows from its category, not from its position, so
sentences that are in no template are understood as well. No sentence is known as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum, auto

from codediffuser.errors import InstructionError
from codediffuser.labeling.language.lexicon import CAN_SAY, Kind, Token, tokenize
from codediffuser.labeling.language.meaning import Description, Request
from codediffuser.labeling.language.noun_phrase import Phrase
from codediffuser.labeling.language.phrases import STARTS, PhraseReader

CATEGORIES = ("battery", "slot", "crate")
"""What the grammar can speak about: picked, place, and what the places are in."""


class Mood(Enum):
    """What a phrase means in its clause."""

    MOVE = auto()
    STAY = auto()
    MENTION = auto()


def parse_instruction(text: str) -> Request:
    """Understand an instruction.

    Raises:
        InstructionError: A word is unknown, nothing is named to pick or to place it at, or the
            phrases contradict each other; the message says what and what could be said instead.
    """
    return _SentenceReader(tokenize(text), text).request()


@dataclass(slots=True)
class _State:
    """What has been understood so far."""

    targets: dict[str, Description] = field(default_factory=dict)
    """Category to what is meant: battery, slot."""
    excluded: list[Description] = field(default_factory=list)
    last: dict[str, tuple[Mood, Description]] = field(default_factory=dict)
    """Category to its last mention, for corrections and pronouns."""
    last_category: str = "battery"
    whole_crate: bool = False
    """Whether the place is given only as the crate: any slot."""


@dataclass(slots=True)
class _Clause:
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


class _SentenceReader:
    """Walks the tokens once; phrases are read by `PhraseReader`."""

    def __init__(self, tokens: list[Token], text: str) -> None:
        self._tokens = tokens
        self._text = text
        self._phrases = PhraseReader(tokens, text)
        self._state = _State()
        self._clause = _Clause()

    def request(self) -> Request:
        """Read everything and say what it means."""
        at = 0
        while at < len(self._tokens):
            at = self._step(at)
        targets = self._state.targets
        if self._state.whole_crate and "slot" not in targets:
            targets["slot"] = Description("slot", "the crate")
        for category, example in (("battery", "the left-most battery"), ("slot", "into a slot")):
            if category not in targets:
                raise InstructionError(
                    f"the instruction names no {category}: {self._text!r}; say for example "
                    f"'{example}'; I understand {CAN_SAY}"
                )
        self._check_others()
        return Request(targets["battery"], targets["slot"], tuple(self._state.excluded))

    def _check_others(self) -> None:
        for target in self._state.targets.values():
            if target.other and not any(
                e.category == target.category for e in self._state.excluded
            ):
                raise InstructionError(
                    f"'{target.said}' is other than what? No {target.category} is named before "
                    f"it as one that stays, in {self._text!r}"
                )

    def _step(self, at: int) -> int:
        """Take the word, or the whole phrase, at a position; return where the next one begins."""
        clause, token = self._clause, self._tokens[at]
        word, kind = token.text, token.kind
        if kind is Kind.STOP:
            self._clause = _Clause(correcting="instead" in self._sentence_words(at + 1))
        elif at == 0 and "instead" in self._sentence_words(0) and not clause.correcting:
            clause.correcting = True
            return at
        elif kind is Kind.CORRECTION:
            self._clause = _Clause(correcting=True)
        elif kind is Kind.THERE:
            if self._phrases.kind(at + 1) is Kind.BE:
                clause.mood, clause.verb = Mood.MENTION, True
        elif kind is Kind.EXCEPT:
            clause.leaves_out = True
        elif kind is Kind.NOT:
            clause.negated = True
        elif kind in (Kind.MOVE, Kind.USE, Kind.KEEP):
            self._verb(kind)
        elif kind in (Kind.INTO, Kind.OF, Kind.OUTSIDE):
            clause.into = kind is Kind.INTO
        elif word in ("i", "we", "he", "she", "they"):
            clause.speaker = True
        elif kind is Kind.PERSON:
            clause.speaker = False
        elif kind in STARTS and not self._is_adverb(at):
            return self._phrase(at)
        return at + 1

    def _sentence_words(self, at: int) -> list[str]:
        words = []
        while at < len(self._tokens) and self._tokens[at].kind is not Kind.STOP:
            words.append(self._tokens[at].text)
            at += 1
        return words

    def _is_adverb(self, at: int) -> bool:
        """`put it back in`, `that the battery`: words that begin no phrase here."""
        word, after = self._phrases.word(at), self._phrases.kind(at + 1)
        if word == "left" and self._clause.mood is Mood.MENTION and not self._clause.into:
            return self._phrases.kind(at - 1) in (Kind.BATTERY, Kind.SLOT, Kind.ONE)
        if word in ("back", "right", "left"):
            return after in (Kind.INTO, Kind.OUTSIDE)
        return word == "that" and after in (Kind.THE, Kind.ANY)

    def _verb(self, kind: Kind) -> None:
        clause = self._clause
        if kind is Kind.MOVE:
            clause.mood = Mood.STAY if clause.negated else Mood.MOVE
        elif kind is Kind.KEEP:
            clause.mood = Mood.MOVE if clause.negated else Mood.STAY
        elif clause.speaker:
            # "I will not use this one" offers it; "I need this one" keeps it back.
            clause.mood = Mood.MENTION if clause.negated else Mood.STAY
        else:
            clause.mood = Mood.STAY if clause.negated else Mood.MOVE
        clause.selects = kind is Kind.USE
        clause.verb, clause.negated, clause.into = True, False, False

    def _phrase(self, at: int) -> int:
        """Read one noun phrase and take up what it says."""
        clause = self._clause
        phrase = self._phrases.read(at, self._category_by_place())
        if clause.correcting and not clause.into:
            # "sorry, the left one into the nearest one": what goes into something is picked.
            picked = self._phrases.read(at, "battery")
            if self._goes_into(picked.end):
                phrase = picked
        if phrase.head == "pronoun":
            self._pronoun(phrase)
        elif phrase.head == "container":
            if clause.into and clause.mood is Mood.MOVE:
                self._state.whole_crate = True
        elif phrase.head in ("thing", "region") or (
            phrase.head in ("none", "area") and phrase.tells
        ):
            self._description(phrase)
        clause.into = clause.leaves_out = False
        return max(phrase.end, at + 1)

    def _category_by_place(self) -> str:
        """What `one`, or a phrase without a noun, stands for at this place of the sentence."""
        clause, state = self._clause, self._state
        if clause.into and clause.mood is Mood.MOVE:
            return "slot"
        replaces = clause.correcting or clause.negated or clause.leaves_out
        narrows = replaces or clause.selects
        unnamed = "battery" not in clause.named
        if clause.mood is Mood.MOVE and not narrows and unnamed and (
            "battery" not in state.targets or clause.verb
        ):  # fmt: skip
            return "battery"
        return state.last_category

    def _goes_into(self, at: int) -> bool:
        """Whether a place follows at this position."""
        starts = self._phrases.kind(at) is Kind.INTO and self._phrases.kind(at + 1) in STARTS
        return starts and self._phrases.read(at + 1, "slot").head != "container"

    def _pronoun(self, phrase: Phrase) -> None:
        """`it`: the battery that was spoken of last, unless a target is set already."""
        state, clause = self._state, self._clause
        if clause.mood is not Mood.MOVE:
            return
        category = "slot" if clause.into else "battery"
        if category in state.targets:
            return
        if category not in state.last or state.last[category][0] is Mood.STAY:
            word = self._phrases.word(phrase.start)
            raise InstructionError(
                f"'{word}' refers to no {category} that was named before, in {self._text!r}"
            )
        self._target(state.last[category][1])

    def _description(self, phrase: Phrase) -> None:
        """A battery or slot: target, exception, or mere mention."""
        clause, state = self._clause, self._state
        described = phrase.describe()
        mood = clause.mood
        if mood is Mood.STAY and described.category == "slot" and not self._keeps_places(phrase):
            mood = Mood.MOVE
        if clause.leaves_out or (clause.negated and mood is Mood.MOVE):
            mood, clause.negated = Mood.STAY, False
        elif clause.correcting and described.category not in clause.corrected:
            mood = self._correct(described, mood)
        if phrase.several and described.category == "battery" and mood is Mood.MOVE:
            raise InstructionError(
                f"'{described.said}' asks for more than one, but one is moved at a time; say 'a "
                f"battery' or 'one of the batteries', in {self._text!r}"
            )
        state.last[described.category] = (mood, described)
        state.last_category = described.category
        if mood is Mood.MOVE:
            self._target(described)
        elif mood is Mood.STAY and not described.other:
            state.excluded.append(described)

    def _keeps_places(self, phrase: Phrase) -> bool:
        """Whether a slot in a clause of staying is kept free: with `keep`, not with `use`."""
        kinds = [token.kind for token in self._tokens[: phrase.start]]
        verbs = [k for k in kinds if k in (Kind.MOVE, Kind.USE, Kind.KEEP)]
        return bool(verbs) and verbs[-1] is not Kind.USE

    def _correct(self, described: Description, mood: Mood) -> Mood:
        """Take back the last mention of the category; the new one comes in its place."""
        clause, state, category = self._clause, self._state, described.category
        clause.corrected.add(category)
        if category not in state.last:
            return mood
        old_mood, old = state.last[category]
        if not clause.verb:
            mood = old_mood
        if old_mood is Mood.STAY and old in state.excluded and mood is Mood.STAY:
            state.excluded.remove(old)
        elif mood is Mood.MOVE:
            state.targets.pop(category, None)
            if described.other:
                state.excluded.append(old)
        return mood

    def _target(self, described: Description) -> None:
        """Set a target; a second one may only repeat it or make a plain one more precise."""
        state, category = self._state, described.category
        self._clause.named.add(category)
        old = state.targets.get(category)
        if old is None or old.is_plain:
            state.targets[category] = described
        elif described.is_plain or described.same_meaning(old):
            return
        elif _only_bands(described) and not {b.axis for b in described.bands} & {
            b.axis for b in old.bands
        }:
            said = f"{old.said}, {described.said}"  # "in the back row, left column"
            state.targets[category] = replace(old, said=said, bands=old.bands + described.bands)
        else:
            raise InstructionError(
                f"the instruction names two things of category {category}, '{old.said}' and "
                f"'{described.said}', but one is moved at a time; say 'sorry, {described.said}' "
                "for a correction"
            )


def _only_bands(described: Description) -> bool:
    """Whether rows and columns are all that a phrase tells."""
    return bool(described.bands) and replace(described, bands=()).is_plain
