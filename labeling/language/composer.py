"""Write programs without a language model: instruction -> meaning -> program text.

The programs are in the style that language models are asked for (supplement I.B, I.C): detect
lists of objects, narrow them down by the means of their points, answer with [pick, place]. They
pass the same checker and run in the same sandbox as any other program.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from codediffuser.errors import ConfigError, InstructionError
from codediffuser.labeling.language.detection import variable
from codediffuser.labeling.language.grammar import parse_instruction
from codediffuser.labeling.language.instances import Directions
from codediffuser.labeling.language.meaning import Band, Description, Distance, Level, Request, Side
from codediffuser.labeling.language.neighbours import relation_lines
from codediffuser.labeling.language.vocabulary import Vocabulary, vocabulary_of

AXIS_NAMES = ("x", "y")

_CENTER = 'np.mean(obj["pcd"], axis=0)'


def compose_program(
    instruction: str,
    categories: Sequence[str] | None = None,
    directions: Directions | None = None,
    vocabulary: Vocabulary | None = None,
) -> str:
    """Write the program of an instruction.

    Args:
        instruction: What a person says.
        categories: Those of the scene; None takes all that the vocabulary speaks of.
        directions: Whose left and right the words mean.
        vocabulary: The task's words; None takes those of `pack_battery`.

    Raises:
        InstructionError: The instruction is not understood, or speaks of what the scene lacks.
        ConfigError: The observer does not look along a world axis.
    """
    words = vocabulary or vocabulary_of()
    present = words.categories if categories is None else tuple(categories)
    missing = [c for c in words.needed if c not in present]
    if missing:
        raise InstructionError(
            f"the built-in composer speaks of {', '.join(words.needed)}; this scene has no "
            f"category {', '.join(missing)}; use a language model for other tasks"
        )
    request = parse_instruction(instruction, words)
    return _Writer(request, directions or Directions(), words, present).program()


class _Writer:
    """Collects the lines of one program."""

    def __init__(
        self,
        request: Request,
        directions: Directions,
        words: Vocabulary,
        categories: Sequence[str],
    ) -> None:
        self._request = request
        self._right = _axis(directions.right)
        self._front = _axis(directions.front)
        self._pick, self._place = words.pick, words.place
        self._words = words
        self._holder = words.holder if words.holder in categories else None
        self._lines: list[str] = []

    def program(self) -> str:
        """The whole text."""
        request, pick, place = self._request, self._pick, self._place
        if self._holder is not None:
            self._extents(self._holder)
        self._waiting()
        if any(isinstance(_reference(d), Description) for d in (request.place, *request.excluded)):
            self._say(f"every_{pick} = {pick}_list")
        self._say(f"# Free {self._words.plural(place)}", f'{place}_list = self.detect("{place}")')
        for described in request.excluded:
            if described.category == pick:
                self._leave_out(described)
        self._say(f"# Determine target object: {request.pick.said}")
        self._choose(request.pick, pick, self._narrow(request.pick))
        for described in request.excluded:
            if described.category == place:
                self._leave_out(described)
        self._say(f"# Determine target place: {request.place.said}")
        self._choose(request.place, place, self._narrow(request.place))
        self._say(f"output_var = [{pick}, {place}]")
        return "\n".join(self._lines) + "\n"

    def _say(self, *lines: str) -> None:
        self._lines += lines

    def _extents(self, holder: str) -> None:
        why = ": rows and columns are parts of them" if self._words.grid else ""
        name = variable(holder)
        self._say(
            f"# Extents of the {holder}{why}",
            f'{name} = self.detect("{holder}")[0]["pcd"]',
            f"x_low, y_low, z_low = np.min({name}, axis=0)",
            f"x_high, y_high, z_high = np.max({name}, axis=0)",
        )

    def _waiting(self) -> None:
        """The list of what can be picked, and for neighbours that of what stands in the holder."""
        pick, every = self._pick, self._words.plural(self._pick)
        if self._holder is None:
            self._say(f"# {every.capitalize()}", f'{pick}_list = self.detect("{pick}")')
            return
        packed = "stand there" if self._words.neighbours else "are packed"
        self._say(
            f"# {every.capitalize()} outside the {self._holder}: those inside {packed} already",
            f"{pick}_list = []",
            *(["row_list = []"] if self._words.neighbours else []),
            f'for obj in self.detect("{pick}"):',
            f"    x, y, z = {_CENTER}",
            "    if x < x_low or x > x_high or y < y_low or y > y_high:",
            f"        {pick}_list.append(obj)",
        )
        if self._words.neighbours:
            self._say("    else:", "        row_list.append(obj)")

    def _leave_out(self, described: Description) -> None:
        """Take away from the list what the words say should stay."""
        if described.is_plain:
            return  # "keep one on the table" is true of any choice.
        things = f"{variable(described.category)}_list"
        self._say(f"# Leave out: {described.said}")
        matching = self._narrow(described, "kept_list")
        if described.sides or described.distance:
            self._choose(described, "kept", matching)
            self._say(f"{things} = [obj for obj in {things} if obj != kept]")
        else:
            self._say(f"{things} = [obj for obj in {things} if obj not in {matching}]")

    def _narrow(
        self, described: Description, name: str | None = None, source: str | None = None
    ) -> str:
        """Write the list of what looks right and lies where the words say; its name."""
        source = source or f"{described.category}_list"
        name = name or source
        for look in described.looks:
            phrase, seen = f"{look} {described.category}", f"{variable(look)}_list"
            self._say(
                f'{seen} = self.detect("{phrase}")',
                f"{name} = [obj for obj in {source} if obj in {seen}]",
            )
            source = name
        if described.level is not None:
            self._say(*self._level_lines(described.level, name, source))
            source = name
        if described.relation is not None:
            anchors = [
                self._narrow(anchor, f"anchor_{i}_list", "row_list")
                for i, anchor in enumerate(described.relation.anchors)
            ]
            self._say(*relation_lines(described.relation, anchors, name, source, self._right))
            source = name
        for band in described.bands:
            test = self._band_test(band, f"{band.axis}_edge")
            self._say(f"{name} = [obj for obj in {source} if {test}]")
            source = name
        return source

    def _level_lines(self, level: Level, name: str, source: str) -> list[str]:
        """Keep the places of a level: at the top, below it, or at the bottom."""
        margin, height = self._words.level_m, f"{_CENTER}[2]"
        test = {"top": f"{height} > top - {margin}", "middle": f"{height} < top - {margin}"}.get(
            level, f"{height} < bottom + {margin}"
        )
        extreme = "bottom = np.min" if level == "bottom" else "top = np.max"
        return [
            f"{extreme}([{height} for obj in {source}])",
            f"{name} = [obj for obj in {source} if {test}]",
        ]

    def _band_test(self, band: Band, edge: str) -> str:
        """Write the edges of a band; return the test of an object's middle against them."""
        axis, sign = self._front if band.axis == "row" else self._right
        low, high = f"{AXIS_NAMES[axis]}_low", f"{AXIS_NAMES[axis]}_high"
        if self._words.grid is None:
            raise InstructionError(f"there are no rows and columns of {self._place}s in this task")
        width, value = f"({high} - {low}) / {self._words.grid[axis]}", f"{_CENTER}[{axis}]"
        if band.side == "middle":
            self._say(f"{edge}_low = {low} + {width}", f"{edge}_high = {high} - {width}")
            return f"{edge}_low < {value} < {edge}_high"
        if (band.side in ("front", "right")) == (sign > 0):
            self._say(f"{edge} = {high} - {width}")
            return f"{value} > {edge}"
        self._say(f"{edge} = {low} + {width}")
        return f"{value} < {edge}"

    def _choose(self, described: Description, name: str, things: str) -> None:
        """Write the choice of one of a list; None if there is none."""
        distance = described.distance
        needed = [f"len({things}) > 0"]
        if distance is not None and isinstance(distance.reference, Description):
            others = self._narrow(distance.reference, "reference_list", f"every_{self._pick}")
            self._choose(distance.reference, "reference", others)
            needed.insert(0, "reference is not None")
        elif distance is not None and distance.reference == "picked":
            needed.insert(0, f"{self._pick} is not None")
        self._say(f"{name} = None", f"if {' and '.join(needed)}:")
        lines = self._score(described, things)
        if lines is None:
            lines = [f"{name} = {things}[0]"]
        else:
            lines[-1] = f"{name} = {things}[{lines[-1]}]"
        self._say(*(f"    {line}" for line in lines))

    def _score(self, described: Description, things: str) -> list[str] | None:
        """Lines that rate a list, and last the expression of the best index; None for any."""
        if described.sides and described.distance:
            raise InstructionError(
                f"'{described.said}' is both a side and a distance; say one of them"
            )
        if described.distance is not None:
            return self._distance_score(described.distance, things)
        if not described.sides:
            return None
        return self._side_score(described, things)

    def _distance_score(self, distance: Distance, things: str) -> list[str]:
        if distance.reference == "robot":
            side: Side = "front" if distance.kind == "nearest" else "back"
            return self._extreme((side,), things)
        if distance.reference == "holder" and self._holder is None:
            raise InstructionError(f"this scene has no {self._words.holder} to measure from")
        origin = {
            "picked": f'np.mean({self._pick}["pcd"], axis=0)',
            "holder": f"np.mean({variable(self._holder or '')}, axis=0)",
        }.get(str(distance.reference), 'np.mean(reference["pcd"], axis=0)')
        best = "argmin" if distance.kind == "nearest" else "argmax"
        return [
            f"origin = {origin}",
            f"distances = [np.linalg.norm({_CENTER} - origin) for obj in {things}]",
            f"np.{best}(distances)",
        ]

    def _side_score(self, described: Description, things: str) -> list[str]:
        sides = described.sides
        if {"top", "bottom"} & set(sides):
            raise InstructionError(f"'{described.said}': nothing lies higher than the rest here")
        clash = {"left", "right"} <= set(sides) or {"front", "back"} <= set(sides)
        if clash or len(sides) > 2 or (len(sides) == 2 and "middle" in sides):
            raise InstructionError(f"'{described.said}' cannot be {' and '.join(sides)} at once")
        if sides == ("middle",) and described.category == self._place and self._words.grid:
            return [
                "middle = np.array([(x_low + x_high) / 2, (y_low + y_high) / 2])",
                f"distances = [np.linalg.norm({_CENTER}[:2] - middle) for obj in {things}]",
                "np.argmin(distances)",
            ]
        if sides == ("middle",):
            axis = self._right[0]
            return [
                f"order = np.argsort([{_CENTER}[{axis}] for obj in {things}])",
                f"order[len({things}) // 2]",
            ]
        return self._extreme(sides, things)

    def _extreme(self, sides: tuple[Side, ...], things: str) -> list[str]:
        """One side: the least or greatest coordinate. Two: the corner between them."""
        terms = []
        for side in sides:
            axis, sign = self._right if side in ("left", "right") else self._front
            terms.append((axis, sign if side in ("right", "front") else -sign))
        if len(terms) == 1:
            axis, sign = terms[0]
            values = f"{things.removesuffix('_list')}_{AXIS_NAMES[axis]}"
            best: Literal["argmax", "argmin"] = "argmax" if sign > 0 else "argmin"
            return [
                f"{values} = [{_CENTER}[{axis}] for obj in {things}]",
                f"np.{best}({values})",
            ]
        parts = "".join(f" {'+' if s > 0 else '-'} {_CENTER}[{a}]" for a, s in terms)
        return [
            f"toward_corner = [{parts.removeprefix(' + ').strip()} for obj in {things}]",
            "np.argmax(toward_corner)",
        ]


def _reference(described: Description) -> object:
    """What a phrase measures from, if it does."""
    return described.distance.reference if described.distance else None


def _axis(direction: tuple[float, float]) -> tuple[int, int]:
    """World axis and sign of a direction.

    Raises:
        ConfigError: The direction lies along neither axis.
    """
    for axis in (0, 1):
        if abs(direction[1 - axis]) < 1e-6:
            return axis, 1 if direction[axis] > 0 else -1
    raise ConfigError(
        f"the built-in composer needs an observer along the world's x or y axis, got {direction}; "
        "change `observer` in the task's YAML or use a language model"
    )
