"""Write programs without a language model: instruction -> meaning -> program text.

The programs are in the style that language models are asked for (supplement I.B, I.C): detect
lists of objects, narrow them down by the means of their points, answer with [pick, place]. They
pass the same checker and run in the same sandbox as any other program.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from codediffuser.errors import ConfigError, InstructionError
from codediffuser.labeling.language.grammar import CATEGORIES, parse_instruction
from codediffuser.labeling.language.instances import Directions
from codediffuser.labeling.language.meaning import Band, Description, Distance, Request, Side

PARTS = {0: 4, 1: 3}
"""World axis to the number of bands that the crate has along it: 4 columns in x, 3 rows in y."""

AXIS_NAMES = ("x", "y")

_CENTER = 'np.mean(obj["pcd"], axis=0)'


def compose_program(
    instruction: str, categories: Sequence[str] = CATEGORIES, directions: Directions | None = None
) -> str:
    """Write the program of an instruction.

    Raises:
        InstructionError: The instruction is not understood, or speaks of what the scene lacks.
        ConfigError: The observer does not look along a world axis.
    """
    missing = [c for c in CATEGORIES if c not in categories]
    if missing:
        raise InstructionError(
            f"the built-in composer speaks of {', '.join(CATEGORIES)}; this scene has no category "
            f"{', '.join(missing)}; use a language model for other tasks"
        )
    return _Writer(parse_instruction(instruction), directions or Directions()).program()


def compose_detection(phrase: str, categories: Sequence[str]) -> str:
    """Write the program that finds what a phrase names: all of a category, or those that look so.

    Raises:
        InstructionError: The phrase names none of the categories.
    """
    words = re.findall(r"[\w']+", phrase.lower())
    named = [c for c in categories if {c, f"{c}s", f"{c[:-1]}ies"} & set(words)]
    if len(named) != 1:
        raise InstructionError(
            f"the phrase {phrase!r} should name one category of {', '.join(categories)}"
        )
    category = named[0]
    lines = [f'{category}_list = self.get_obj("{category}")']
    if len(words) == 1:
        return "\n".join([*lines, f"output_var = {category}_list", ""])
    quoted = " ".join(words)
    lines += [
        f'indices = self.find_instance_in_category(instance="{quoted}", category="{category}")',
        f"output_var = [{category}_list[i] for i in indices]",
        "",
    ]
    return "\n".join(lines)


class _Writer:
    """Collects the lines of one program."""

    def __init__(self, request: Request, directions: Directions) -> None:
        self._request = request
        self._right = _axis(directions.right)
        self._front = _axis(directions.front)
        self._lines: list[str] = []

    def program(self) -> str:
        """The whole text."""
        request = self._request
        self._crate()
        self._batteries()
        if any(isinstance(_reference(d), Description) for d in (request.place, *request.excluded)):
            self._say("every_battery = battery_list")
        self._slots()
        for described in request.excluded:
            if described.category == "battery":
                self._leave_out(described)
        self._say(f"# Determine target object: {request.pick.said}")
        self._choose(request.pick, "battery", self._narrow(request.pick))
        for described in request.excluded:
            if described.category == "slot":
                self._leave_out(described)
        self._say(f"# Determine target place: {request.place.said}")
        self._choose(request.place, "slot", self._narrow(request.place))
        self._say("output_var = [battery, slot]")
        return "\n".join(self._lines) + "\n"

    def _say(self, *lines: str) -> None:
        self._lines += lines

    def _crate(self) -> None:
        self._say(
            "# Extents of the crate: rows and columns are parts of them",
            'crate = self.detect("crate")[0]["pcd"]',
            "x_low, y_low, z_low = np.min(crate, axis=0)",
            "x_high, y_high, z_high = np.max(crate, axis=0)",
        )

    def _batteries(self) -> None:
        self._say(
            "# Batteries outside the crate: those inside are packed already",
            "battery_list = []",
            'for obj in self.detect("battery"):',
            f"    x, y, z = {_CENTER}",
            "    if x < x_low or x > x_high or y < y_low or y > y_high:",
            "        battery_list.append(obj)",
        )

    def _slots(self) -> None:
        self._say("# Free slots", 'slot_list = self.detect("slot")')

    def _leave_out(self, described: Description) -> None:
        """Take away from the list what the words say should stay."""
        if described.is_plain:
            return  # "keep one on the table" is true of any choice.
        things = f"{described.category}_list"
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
        """Write the list of what has the right looks and lies in the right bands; its name."""
        source = source or f"{described.category}_list"
        name = name or source
        for look in described.looks:
            phrase = f"{look} {described.category}"
            self._say(
                f'{look}_list = self.detect("{phrase}")',
                f"{name} = [obj for obj in {source} if obj in {look}_list]",
            )
            source = name
        for band in described.bands:
            test = self._band_test(band, f"{band.axis}_edge")
            self._say(f"{name} = [obj for obj in {source} if {test}]")
            source = name
        return source

    def _band_test(self, band: Band, edge: str) -> str:
        """Write the edges of a band; return the test of an object's middle against them."""
        axis, sign = self._front if band.axis == "row" else self._right
        low, high = f"{AXIS_NAMES[axis]}_low", f"{AXIS_NAMES[axis]}_high"
        width, value = f"({high} - {low}) / {PARTS[axis]}", f"{_CENTER}[{axis}]"
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
            others = self._narrow(distance.reference, "reference_list", "every_battery")
            self._choose(distance.reference, "reference", others)
            needed.insert(0, "reference is not None")
        elif distance is not None and distance.reference == "picked":
            needed.insert(0, "battery is not None")
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
        origin = {
            "picked": 'np.mean(battery["pcd"], axis=0)',
            "crate": "np.mean(crate, axis=0)",
        }.get(str(distance.reference), 'np.mean(reference["pcd"], axis=0)')
        best = "argmin" if distance.kind == "nearest" else "argmax"
        return [
            f"origin = {origin}",
            f"distances = [np.linalg.norm({_CENTER} - origin) for obj in {things}]",
            f"np.{best}(distances)",
        ]

    def _side_score(self, described: Description, things: str) -> list[str]:
        sides = described.sides
        clash = {"left", "right"} <= set(sides) or {"front", "back"} <= set(sides)
        if clash or len(sides) > 2 or (len(sides) == 2 and "middle" in sides):
            raise InstructionError(f"'{described.said}' cannot be {' and '.join(sides)} at once")
        if sides == ("middle",) and described.category == "slot":
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
