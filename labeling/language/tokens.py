"""Split an instruction into words whose kind is known, in the vocabulary of one task."""

from __future__ import annotations

import difflib
import functools
import re
from dataclasses import dataclass

from codediffuser.errors import InstructionError
from codediffuser.labeling.language.lexicon import KINDS, Kind
from codediffuser.labeling.language.vocabulary import Vocabulary


@dataclass(frozen=True, slots=True)
class Token:
    """One word or stop, in lower case; a title is one token, however many words it has."""

    text: str
    kind: Kind


_REWRITES = (
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
    (r"\bout of (my|our|your|the) way\b", "away"),
    (r"\bout of\b", "outside"),
    (r"\bin front of\b", "outside"),
    (r"\b(someone|somebody|i|we|he|she|they|who) left\b", r"\1 forgot"),
    # What need not be is no wish.
    (r"\b(do|does) not (have|need) to be [^.!?;,]*", " "),
    (r"\bother than\b", "except"),
    (r"\b(instead of|apart from|rather than)\b", "except"),
    (r"\bmake that\b", "sorry"),
    (r"(^|[.!?;,]\s*|\boh\s+)no\b", r"\1 sorry"),
)  # fmt: skip

_WITH_NEIGHBOURS = (
    (r"\b(right |directly |immediately |just |straight )?(next to|beside|adjacent to)\b",
     "adjacent"),
    (r"\b(right|directly|immediately|just|straight) (to|on) the (left|right) (side )?of\b",
     r"adjacent \3 of"),
    (r"\bin between\b", "between"),
    (r"\b(in|to|into|at) its (own |right |usual |proper )?place\b", " "),
)  # fmt: skip
_WITHOUT_NEIGHBOURS = ((r"\bnext to\b", "beside"),)

_TITLE_MARK = "\u241f"
"""Stands for a title while the words around it are rewritten; no keyboard types it."""
_QUOTED = re.compile(
    r"[\"\u201c\u201d\u00ab\u00bb]([^\"\u201c\u201d\u00ab\u00bb]+)[\"\u201c\u201d\u00ab\u00bb]"
)
_CAPITALS = re.compile(r"\b[A-Z][A-Z0-9]+(?:[ -][A-Z0-9]{2,})*\b")
_CAPITALISED = re.compile(r"\b[A-Z][a-z]+\b(?!')")


class Lexicon:
    """All words that an instruction of one task may have.

    Args:
        vocabulary: The task's nouns.
    """

    def __init__(self, vocabulary: Vocabulary) -> None:
        self.vocabulary = vocabulary
        self.kinds = dict(KINDS)
        roles = {vocabulary.pick: Kind.PICK, vocabulary.place: Kind.PLACE}
        for category, words in vocabulary.nouns:
            self.kinds.update(dict.fromkeys(words, roles.get(category, Kind.CONTAINER)))
        neighbours = _WITH_NEIGHBOURS if vocabulary.neighbours else _WITHOUT_NEIGHBOURS
        what = (r"\bwhat(ever)? (is|lies|stands|sits|waits)\b", f"the {vocabulary.pick}")
        self._rewrites = (*neighbours, *_REWRITES, what, (r"-", " "))
        nouns = "|".join(vocabulary.words_for(vocabulary.pick))
        self._owner = re.compile(rf"\b\w+'s (?=(?:{nouns})\b)", re.IGNORECASE)

    def tokenize(self, text: str) -> list[Token]:
        """Split an instruction into known words and stops.

        Raises:
            InstructionError: It is empty, or has a word that no table knows; the message names the
                word, the closest known one, and what can be said.
        """
        plain, titles = self._take_titles(self._owner.sub("the ", re.sub("[’`]", "'", text)))
        plain = self._rewritten(plain.lower())
        tokens = []
        for part in re.findall(rf"[\w'{_TITLE_MARK}]+|[.!?;:]|,|[^\s\w]", plain):
            if part in ".!?;:":
                tokens.append(Token(part, Kind.STOP))
            elif part == ",":
                tokens.append(Token(part, Kind.COMMA))
            elif part == _TITLE_MARK:
                tokens.append(Token(titles.pop(0), Kind.TITLE))
            elif part in self.kinds:
                tokens.append(Token(part, self.kinds[part]))
            elif (verb := self._base_form(part)) is not None:
                tokens.append(Token(part, self.kinds[verb]))
            elif re.search(r"\w", part):
                raise InstructionError(self.unknown_word(part, text))
        if not any(token.kind not in (Kind.STOP, Kind.COMMA) for token in tokens):
            raise InstructionError(
                f"the instruction is empty: {text!r}; I understand {self.vocabulary.can_say}"
            )
        return tokens

    def _rewritten(self, plain: str) -> str:
        for pattern, replacement in self._rewrites:
            plain = re.sub(pattern, replacement, plain)
        return plain

    def _take_titles(self, text: str) -> tuple[str, list[str]]:
        """Put a mark in the place of each title; the titles in order, in lower case."""
        if not self.vocabulary.titles:
            return text, []
        found: list[str] = []

        def mark(match: re.Match[str]) -> str:
            found.append(match.group(match.lastindex or 0).lower())
            return f" {_TITLE_MARK} "

        def mark_unknown(match: re.Match[str]) -> str:
            words = self._rewritten(match.group().lower()).split()
            known = all(w in self.kinds or self._base_form(w) is not None for w in words)
            return match.group() if known else mark(match)

        # One pass, so that the titles come in the order of the text.
        patterns = (_QUOTED, _CAPITALS, _CAPITALISED)
        every = re.compile("|".join(f"(?:{p.pattern})" for p in patterns))
        marked = every.sub(
            lambda m: mark_unknown(m) if _CAPITALISED.fullmatch(m.group()) else mark(m), text
        )
        return marked, found

    def _base_form(self, word: str) -> str | None:
        """The known verb that `word` is a form of: `putting`, `places`, `dropped`."""
        verbs = (Kind.MOVE, Kind.USE, Kind.KEEP)
        for ending in ("ing", "ed", "es", "s"):
            stem = word.removesuffix(ending)
            if stem != word and len(stem) > 1:
                for base in (stem, stem + "e", stem[:-1] if stem[-1] == stem[-2] else stem):
                    if self.kinds.get(base) in verbs:
                        return base
        return None

    def unknown_word(self, word: str, text: str) -> str:
        """Say which word is not understood, and what would be."""
        close = difflib.get_close_matches(word, sorted(self.kinds), n=1, cutoff=0.75)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        return (
            f"the word '{word}'{hint} is not understood in {text!r}; I understand "
            f"{self.vocabulary.can_say}"
        )


@functools.lru_cache(maxsize=32)
def lexicon_of(vocabulary: Vocabulary) -> Lexicon:
    """The lexicon of a vocabulary, built once."""
    return Lexicon(vocabulary)
