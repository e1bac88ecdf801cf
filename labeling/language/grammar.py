"""Understand an instruction: what to pick, where to place it.

    instruction = sentence {stop sentence}
    sentence    = {verb | preposition | filler | phrase | correction}

Verbs set what the phrases after them mean: with `put`, `take`, ... they name what to move and where
to; with `keep`, or with `use` and `need` of the speaker's own (`I need to use X`), what must stay;
after `there are` they only introduce. `sorry` and its like make the next phrase replace the last
one of its kind. Which role a phrase has follows from its category, not from its position, so
sentences that are in no template are understood as well. No sentence is known as a whole. Nouns,
and by what places are told apart, come from the task's vocabulary.
"""

from __future__ import annotations

from dataclasses import replace

from codediffuser.errors import InstructionError
from codediffuser.labeling.language.clause import Clause, Mood, State
from codediffuser.labeling.language.lexicon import Kind
from codediffuser.labeling.language.meaning import Description, Relation, Request
from codediffuser.labeling.language.noun_phrase import STARTS, Phrase
from codediffuser.labeling.language.phrases import PhraseReader
from codediffuser.labeling.language.tokens import Lexicon, Token, lexicon_of
from codediffuser.labeling.language.vocabulary import Vocabulary, vocabulary_of


def parse_instruction(text: str, vocabulary: Vocabulary | None = None) -> Request:
    """Understand an instruction.

    Args:
        text: What a person says.
        vocabulary: The task's words; None takes those of `pack_battery`.

    Raises:
        InstructionError: A word is unknown, nothing is named to pick or to place it at, or the
            phrases contradict each other; the message says what and what could be said instead.
    """
    lexicon = lexicon_of(vocabulary or vocabulary_of())
    return _SentenceReader(lexicon.tokenize(text), text, lexicon).request()


class _SentenceReader:
    """Walks the tokens once; phrases are read by `PhraseReader`."""

    def __init__(self, tokens: list[Token], text: str, lexicon: Lexicon) -> None:
        self._tokens = tokens
        self._text = text
        self._words = lexicon.vocabulary
        self._pick, self._place = self._words.pick, self._words.place
        self._phrases = PhraseReader(tokens, text, lexicon)
        self._state = State(last_category=self._pick)
        self._clause = Clause()

    def request(self) -> Request:
        """Read everything and say what it means."""
        at = 0
        while at < len(self._tokens):
            at = self._step(at)
        targets, pick, place = self._state.targets, self._pick, self._place
        if self._state.holder and place not in targets:
            targets[place] = Description(place, self._state.holder)
        for category, example in ((pick, f"the left-most {pick}"), (place, f"into a {place}")):
            if category not in targets:
                raise InstructionError(
                    f"the instruction names no {category}: {self._text!r}; say for example "
                    f"'{example}'; I understand {self._words.can_say}"
                )
        self._check_others()
        return Request(targets[pick], targets[place], tuple(self._state.excluded))

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
        if (relation := self._phrases.relations.read(at)) is not None:
            return self._relation(at, *relation)
        if kind is Kind.STOP:
            self._clause = Clause(correcting="instead" in self._sentence_words(at + 1))
        elif at == 0 and "instead" in self._sentence_words(0) and not clause.correcting:
            clause.correcting = True
            return at
        elif kind is Kind.CORRECTION:
            self._clause = Clause(correcting=True)
        elif kind is Kind.THERE:
            if self._phrases.kind(at + 1) is Kind.BE:
                clause.mood, clause.verb = Mood.MENTION, True
            else:
                self._there()
        elif kind is Kind.EXCEPT:
            clause.leaves_out = True
        elif kind is Kind.NOT:
            clause.negated = True
        elif kind in (Kind.MOVE, Kind.USE, Kind.KEEP):
            self._verb(kind, at)
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
            return self._phrases.kind(at - 1) in (Kind.PICK, Kind.PLACE, Kind.ONE)
        if word == "back" and after in (Kind.STOP, Kind.COMMA):
            return self._phrases.kind(at - 1) in (Kind.PRONOUN, Kind.PICK, Kind.TITLE)
        if word in ("back", "right", "left"):
            return after in (Kind.INTO, Kind.OUTSIDE)
        return word == "that" and after in (Kind.THE, Kind.ANY)

    def _verb(self, kind: Kind, at: int) -> None:
        clause = self._clause
        # "Keep it between A and B", "I need it to be next to A" say where it goes.
        if kind is Kind.MOVE or self._phrases.relations.follows(at):
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
            picked = self._phrases.read(at, self._pick)
            if self._goes_into(picked.end):
                phrase = picked
        if phrase.head == "pronoun":
            self._pronoun(phrase)
        elif phrase.head == "container":
            if clause.into and clause.mood is Mood.MOVE:
                self._state.holder = phrase.said
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
            return self._place
        replaces = clause.correcting or clause.negated or clause.leaves_out
        narrows = replaces or clause.selects
        unnamed = self._pick not in clause.named
        if clause.mood is Mood.MOVE and not narrows and unnamed and (
            self._pick not in state.targets or clause.verb
        ):  # fmt: skip
            return self._pick
        return state.last_category

    def _goes_into(self, at: int) -> bool:
        """Whether a place follows at this position."""
        starts = self._phrases.kind(at) is Kind.INTO and self._phrases.kind(at + 1) in STARTS
        return starts and self._phrases.read(at + 1, self._place).head != "container"

    def _pronoun(self, phrase: Phrase) -> None:
        """`it`: the thing that was spoken of last, unless a target is set already."""
        state, clause = self._state, self._clause
        if clause.mood is not Mood.MOVE:
            return
        category = self._place if clause.into else self._pick
        if category in state.targets:
            return
        if category not in state.last or state.last[category][0] is Mood.STAY:
            word = self._phrases.word(phrase.start)
            raise InstructionError(
                f"'{word}' refers to no {category} that was named before, in {self._text!r}"
            )
        self._target(state.last[category][1])

    def _relation(self, at: int, relation: Relation, end: int) -> int:
        """A place that is only told by what is around it: `... next to COMET`."""
        phrase = Phrase(at, end, "thing", self._place, is_place=True, relation=relation)
        phrase.said = " ".join(token.text for token in self._tokens[at:end])
        self._description(phrase)
        self._clause.into = self._clause.leaves_out = False
        return end

    def _there(self) -> None:
        """`Put it there`: at the place that was spoken of last, unless one is set already."""
        mood, place = self._state.last.get(self._place, (Mood.STAY, None))
        wanted = self._clause.mood is Mood.MOVE and self._place not in self._state.targets
        if wanted and place is not None and mood is not Mood.STAY:
            self._target(place)

    def _description(self, phrase: Phrase) -> None:
        """A thing or place: target, exception, or mere mention."""
        clause, state = self._clause, self._state
        described = self._completed(phrase.describe())
        mood = clause.mood
        if mood is Mood.STAY and phrase.is_place and not self._keeps_places(phrase):
            mood = Mood.MOVE
        elif mood is Mood.STAY and self._phrases.relations.follows(phrase.end):
            mood = Mood.MENTION  # "do not put it next to A" does not say that it stays
        if clause.leaves_out or (clause.negated and mood is Mood.MOVE):
            mood, clause.negated = Mood.STAY, False
        elif clause.correcting and described.category not in clause.corrected:
            mood = self._correct(described, mood)
        if phrase.several and not phrase.is_place and mood is Mood.MOVE:
            raise InstructionError(
                f"'{described.said}' asks for more than one, but one is moved at a time; say 'a "
                f"{self._pick}' or 'one of the {self._words.plural(self._pick)}', in "
                f"{self._text!r}"
            )
        state.last[described.category] = (mood, described)
        state.last_category = described.category
        if mood is Mood.MOVE:
            self._target(described)
        elif mood is Mood.STAY and not described.other:
            state.excluded.append(described)

    def _completed(self, described: Description) -> Description:
        """`sorry, the left side`: beside the same thing as before, on its other side."""
        last = self._state.last.get(self._place)
        relation = None if last is None else last[1].relation
        bare = replace(described, category=self._place, sides=()).is_plain
        if not (self._clause.correcting and bare and relation and relation.side):
            return described
        side = next((s for s in described.sides if s in ("left", "right")), None)
        if side is None:
            return described
        turned = replace(relation, side=side)
        return Description(self._place, described.said, relation=turned)

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
