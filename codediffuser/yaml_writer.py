"""Plain data as YAML 1.2 text, many times faster than a general emitter.

Block style for mappings and for lists that hold mappings or lists; lists of scalars stand on one
line, however long. Strings are quoted when they could be read as anything else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./+-]*(?: [A-Za-z0-9_./+-]+)*")
"""Strings that need no quotes, in block and flow context."""
WORDS_WITH_MEANING = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})
"""Read as something else by YAML 1.2 or 1.1, in any case of letters."""
SEQUENCE = (list, tuple)
ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def dump_yaml(value: Any) -> str:
    """Return the YAML text of mappings, lists, strings, numbers, booleans and None.

    Raises:
        TypeError: The value holds something else.
    """
    return "\n".join(_block(value, 0)) + "\n"


def _block(value: Any, indent: int) -> Iterator[str]:
    """Lines of a value that stands on its own lines."""
    pad = " " * indent
    if isinstance(value, dict) and value:
        for key, item in value.items():
            if _is_nested(item):
                yield f"{pad}{_scalar(key)}:"
                # A list may stand as far left as its key.
                yield from _block(item, indent if isinstance(item, SEQUENCE) else indent + 2)
            else:
                yield f"{pad}{_scalar(key)}: {_inline(item)}"
    elif isinstance(value, SEQUENCE) and _is_nested(value):
        for item in value:
            lines = iter(_block(item, indent + 2))
            yield f"{pad}- {next(lines)[indent + 2 :]}"
            yield from lines
    else:
        yield pad + _inline(value)


def _is_nested(value: Any) -> bool:
    """Whether a value takes lines of its own."""
    if isinstance(value, SEQUENCE):
        return any(isinstance(item, (dict, *SEQUENCE)) for item in value)
    return isinstance(value, dict) and bool(value)


def _inline(value: Any) -> str:
    if isinstance(value, SEQUENCE):
        return f"[{', '.join(_scalar(item) for item in value)}]"
    return "{}" if isinstance(value, dict) else _scalar(value)


def _scalar(value: Any) -> str:
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "null"
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float):
        return _float(float(value))
    raise TypeError(f"cannot write {type(value).__name__} as YAML: {value!r}")


def _float(value: float) -> str:
    if math.isnan(value):
        return ".nan"
    if math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    digits, exponent, power = repr(value).partition("e")
    # Readers of YAML 1.1 take 1e-07 for a string.
    return f"{digits if '.' in digits else digits + '.0'}{exponent}{power}"


def _string(text: str) -> str:
    if PLAIN.fullmatch(text) and text.lower() not in WORDS_WITH_MEANING:
        return text
    return '"' + "".join(_escaped(letter) for letter in text) + '"'


def _escaped(letter: str) -> str:
    if letter in ESCAPES:
        return ESCAPES[letter]
    if letter.isprintable():
        return letter
    code = ord(letter)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
