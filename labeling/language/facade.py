"""Arrays for generated programs: a small part of NumPy, served to the sandbox by the host.

Programs hold `Array` handles; the numbers stay here. Every call is judged before it computes:
which function, which options, plain numbers or handles as arguments, and how large the result can
get. So a program can neither reach NumPy's file and buffer functions nor exhaust the host's memory.
Values come back as plain numbers where NumPy gives scalars, else as new handles.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from codediffuser.labeling.language import allowed

MAX_ELEMENTS = 2_000_000
"""Numbers in one array."""

MAX_TOTAL_ELEMENTS = 20_000_000
"""Numbers in all arrays that one program makes."""

MAX_ROWS = 2_000
"""Rows that a loop over an array may have; each becomes a handle."""

MAX_DIMENSIONS = 4

OPTIONS = frozenset({"axis", "keepdims", "ord", "q", "decimals", "equal_nan", "rtol", "atol"})
"""Keyword options that functions may be given; `out` and `dtype` reach memory and types."""


class Array:
    """Handle of one array. The sandbox sees only its serial number.

    Args:
        values: Numbers of kind bool, int or float.
        serial: Unique within a program, so that equal handles are the same array.
    """

    __slots__ = ("serial", "values")

    def __init__(self, values: np.ndarray, serial: int) -> None:
        self.values = values
        self.serial = serial


_NP: dict[str, Callable[..., Any]] = {
    name: operator.attrgetter(name)(np) for name in allowed.NP_FUNCTIONS
}

_OPERATORS: Mapping[str, Callable[..., Any]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "truediv": operator.truediv,
    "floordiv": operator.floordiv, "mod": operator.mod, "pow": operator.pow,
    "and": operator.and_, "or": operator.or_, "xor": operator.xor,
    "eq": operator.eq, "ne": operator.ne, "lt": operator.lt, "le": operator.le,
    "gt": operator.gt, "ge": operator.ge,
    "iadd": operator.iadd, "isub": operator.isub, "imul": operator.imul,
    "itruediv": operator.itruediv, "ifloordiv": operator.ifloordiv, "imod": operator.imod,
    "ipow": operator.ipow, "iand": operator.iand, "ior": operator.ior, "ixor": operator.ixor,
    "neg": operator.neg, "invert": operator.invert,
}  # fmt: skip
"""What the prelude asks for by name; those with `i` change their first array."""

_BROADCAST = allowed.NP_ELEMENTWISE | {"allclose", "cross"}


@dataclass(slots=True)
class Facade:
    """All array work of one program, within one budget."""

    made: int = 0
    """Numbers in the arrays made so far."""
    serial: int = 0

    def wrap(self, values: np.ndarray, *, frozen: bool = False) -> Array:
        """Make a handle; a frozen array cannot be changed by the program."""
        if frozen:
            values = values.view()
            values.flags.writeable = False
        self.serial += 1
        return Array(values, self.serial)

    def call(self, name: str, args: tuple[Any, ...], options: Mapping[str, Any]) -> Any:
        """Serve one call of the prelude or of `np`.

        Args:
            name: `np.<function>`, `method`, `attr`, `get`, `set`, `rows`, `len`, `truth`,
                `contains`, or an operator of the prelude.
            args: Plain numbers, lists and tuples of them, and handles.
            options: Keyword options.

        Returns:
            A plain number, None, a handle, or a list or tuple of those.

        Raises:
            ValueError, TypeError, IndexError, MemoryError: As NumPy would, or a limit is met.
        """
        with np.errstate(all="ignore"):
            if name == "method":
                return self._method(*args, **options)
            if name.startswith("np."):
                return self._np(name[3:], args, options)
            if name in _OPERATORS:
                return self._operator(name, args)
            return getattr(self, f"_{_OTHER[name]}")(*args)

    def _np(self, name: str, args: tuple[Any, ...], options: Mapping[str, Any]) -> Any:
        if name not in _NP:
            raise TypeError(f"np.{name} is not offered")
        for option in options:
            if option not in OPTIONS:
                raise TypeError(
                    f"np.{name}: the option '{option}' is not offered; offered are "
                    f"{', '.join(sorted(OPTIONS))}"
                )
        plain = [self._plain(argument) for argument in args]
        extra = {key: self._plain(value) for key, value in options.items()}
        self._check_size(name, plain)
        chooses = name in allowed.NP_REDUCTIONS - {"all", "any", "sum"}
        if chooses and plain and _count(plain[0]) == 0:
            raise ValueError(f"np.{name} of an empty array: there is nothing to choose from")
        return self._result(_NP[name](*plain, **extra))

    def _method(self, name: str, array: Any, *args: Any, **options: Any) -> Any:
        values = _values(array)
        if name == "tolist":
            return values.tolist()
        if name == "item":
            return values.item(*args)
        if name in ("copy", "flatten"):
            self._spend(values.size)
            return self.wrap(values.copy() if name == "copy" else values.flatten())
        if name == "reshape" and len(args) > 1:
            args = (list(args),)
        if name not in allowed.ARRAY_METHODS:
            raise TypeError(f"arrays have no .{name}(...)")
        return self._np(name, (array, *args), options)

    def _operator(self, name: str, args: tuple[Any, ...]) -> Any:
        plain = [self._plain(argument) for argument in args]
        self._check_size("add", plain)
        if name.endswith("pow") and isinstance(plain[1], np.ndarray):
            raise TypeError("powers are plain numbers")
        value = _OPERATORS[name](*plain)
        if value is plain[0] and isinstance(args[0], Array):
            return args[0]  # Changed in place, so it stays the same array.
        return self._result(value)

    def _attribute(self, array: Any, name: str) -> Any:
        if name not in allowed.ATTRIBUTES:
            raise AttributeError(f"arrays have no .{name}")
        return self._result(getattr(_values(array), name))

    def _item(self, array: Any, key: Any) -> Any:
        values, index = _values(array), self._index(key)
        many = [_shape(part) for part in _parts(index) if isinstance(part, (list, np.ndarray))]
        if many:  # Lists of indices may repeat rows, so the result can outgrow the array.
            row = values.size // max(values.shape[0], 1) if values.ndim else 1
            self._spend(math.prod(np.broadcast_shapes(*many)) * row, check=True)
        return self._result(values[index])

    def _assign(self, array: Any, key: Any, value: Any) -> None:
        _values(array)[self._index(key)] = self._plain(value)

    def _rows(self, array: Any) -> list[Any]:
        values = _values(array)
        if values.ndim == 1:
            return values.tolist()
        if len(values) > MAX_ROWS:
            raise MemoryError(
                f"loops run over at most {MAX_ROWS} rows, got {len(values)}; use np functions"
            )
        return [self._result(row) for row in values]

    def _length(self, array: Any) -> int:
        return len(_values(array))

    def _truth(self, array: Any) -> bool:
        values = _values(array)
        if values.size > 1:
            raise ValueError(
                f"the truth of an array of shape {values.shape} is ambiguous; use np.any or np.all"
            )
        return bool(values.size and values.item())

    def _contains(self, array: Any, item: Any) -> bool:
        return bool(np.any(_values(array) == self._plain(item)))

    def _index(self, key: Any) -> Any:
        if isinstance(key, tuple):
            if key and key[0] == "slice" and isinstance(key[0], str):
                return slice(*(self._plain(part) for part in key[1:]))
            return tuple(self._index(part) for part in key)
        return self._plain(key)

    def _plain(self, value: Any, depth: int = 0) -> Any:
        """Turn an argument into numbers, NumPy arrays and lists of them, or refuse it."""
        if isinstance(value, Array):
            return value.values
        if value is None or isinstance(value, (bool, float)):
            return value
        if isinstance(value, int):
            if abs(value) > 2**63 - 1:
                raise OverflowError("whole numbers beyond 2**63 are not allowed in arrays")
            return value
        if isinstance(value, (list, tuple)) and depth < MAX_DIMENSIONS:
            items = [self._plain(item, depth + 1) for item in value]
            return items if isinstance(value, list) else tuple(items)
        raise TypeError(
            f"arrays hold numbers, got {_kind(value)}; an object's points are in object['pcd']"
        )

    def _check_size(self, name: str, plain: list[Any]) -> None:
        """Refuse what could become too large, before it is computed."""
        if name in ("zeros", "ones", "full"):
            size = math.prod(abs(int(n)) for n in np.ravel(plain[0]).tolist()) if plain else 0
        elif name == "linspace":
            size = int(plain[2]) if len(plain) > 2 else 50
        elif name == "arange":
            bounds = [*plain, 1.0] if len(plain) == 2 else plain
            size = int(abs((bounds[1] - bounds[0]) / bounds[2]) if len(bounds) > 2 else bounds[0])
        elif name == "dot":
            a, b = _shape(plain[0]), _shape(plain[1])
            summed = b[-2] if len(b) > 1 else b[-1] if b else 1
            size = math.prod(a[:-1]) * (math.prod(b) // max(summed, 1))
        elif name in _BROADCAST:
            size = math.prod(np.broadcast_shapes(*(_shape(operand) for operand in plain)))
        else:
            size = sum(_count(operand) for operand in plain)
        self._spend(size, check=True)

    def _spend(self, size: int, *, check: bool = False) -> None:
        """Count `size` more numbers; with `check`, only see whether they would fit."""
        if size > MAX_ELEMENTS or self.made + size > MAX_TOTAL_ELEMENTS:
            raise MemoryError(
                f"arrays are limited to {MAX_ELEMENTS} numbers each and {MAX_TOTAL_ELEMENTS} in "
                "all; work on means of points instead of all points"
            )
        if not check:
            self.made += size

    def _result(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            if value.dtype.kind not in "biuf" or value.ndim > MAX_DIMENSIONS:
                raise TypeError(
                    f"arrays hold only numbers, in at most {MAX_DIMENSIONS} dimensions, and the "
                    "rows of a list must all have the same length"
                )
            if value.ndim == 0:
                return value.item()
            self._spend(value.size)
            return self.wrap(value)
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, (tuple, list)):
            return tuple(self._result(part) for part in value)
        return value


_OTHER = {
    "attr": "attribute", "get": "item", "set": "assign", "rows": "rows", "len": "length",
    "truth": "truth", "contains": "contains",
}  # fmt: skip


def _values(array: Any) -> np.ndarray:
    if not isinstance(array, Array):
        raise TypeError(f"expected an array, got {_kind(array)}")
    return array.values


def _kind(value: Any) -> str:
    """What a program would call a value: never more than the name of its type."""
    if isinstance(value, (str, dict, set, bytes, list, tuple)) or value is None:
        return type(value).__name__
    return "an object's pointer" if type(value).__name__ == "Pointer" else "something else"


def _parts(index: Any) -> tuple[Any, ...]:
    return index if isinstance(index, tuple) else (index,)


def _count(value: Any) -> int:
    """How many numbers an argument holds."""
    if isinstance(value, np.ndarray):
        return value.size
    if isinstance(value, (list, tuple)):
        return sum(_count(item) for item in value)
    return 1


def _shape(value: Any) -> tuple[int, ...]:
    """Shape for broadcasting; a nested list counts as what it would become."""
    if isinstance(value, np.ndarray):
        return value.shape
    if isinstance(value, (list, tuple)):
        first = _shape(value[0]) if value else ()
        return (len(value), *first)
    return ()
