"""Read back quickly what `dump_yaml` wrote; anything else is left to a full YAML parser.

Nothing is taken on trust: the value counts only when writing it gives the very same text, so a file
that somebody edited is either in the same dialect or not read here.
"""

from __future__ import annotations

import json
import re
from typing import Any

from codediffuser.yaml_writer import dump_yaml

ENTRY = re.compile(r'("(?:[^"\\]|\\.)*"|[^\s"#:][^":]*):(?: (.+))?')
ITEM = re.compile(r'"(?:[^"\\]|\\.)*"|[^,]+')
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
CONSTANTS: dict[str, Any] = {
    "null": None, "true": True, "false": False,
    ".inf": float("inf"), "-.inf": float("-inf"),
}  # fmt: skip


def read_own_yaml(text: str) -> Any | None:
    """The value of a text that `dump_yaml` wrote, or None when it is not exactly such a text."""
    lines = text.split("\n")
    try:
        value, end = _block(lines[:-1], 0, 0)
        own = end == len(lines) - 1 and dump_yaml(value) == text
    except (ValueError, IndexError, RecursionError):
        return None
    return value if own else None


def _block(lines: list[str], start: int, indent: int) -> tuple[Any, int]:
    """The mapping or list that begins at a line, and the line after it."""
    if lines[start].startswith("- ", indent):
        return _list(lines, start, indent)
    return _mapping(lines, start, indent)


def _mapping(lines: list[str], start: int, indent: int) -> tuple[dict[Any, Any], int]:
    found: dict[Any, Any] = {}
    while start < len(lines) and _indent(lines[start]) == indent:
        line = lines[start][indent:]
        entry = ENTRY.fullmatch(line)
        if entry is None:
            if line.startswith("- ") and found:
                break  # The next item of the list that this mapping is in.
            raise ValueError(line)
        key, value = _scalar(entry[1]), entry[2]
        if value is not None:
            found[key], start = _inline(value), start + 1
        else:
            inner = indent if lines[start + 1].startswith("- ", indent) else indent + 2
            found[key], start = _block(lines, start + 1, inner)
    return found, start


def _list(lines: list[str], start: int, indent: int) -> tuple[list[Any], int]:
    found = []
    while start < len(lines) and lines[start].startswith(" " * indent + "- "):
        first = lines[start][indent + 2 :]
        if ENTRY.fullmatch(first) or first.startswith("- "):
            lines[start] = " " * (indent + 2) + first
            value, start = _block(lines, start, indent + 2)
        else:
            value, start = _inline(first), start + 1
        found.append(value)
    return found, start


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" "))


def _inline(text: str) -> Any:
    if text == "{}":
        return {}
    if text.startswith("["):
        return [_scalar(item.strip()) for item in ITEM.findall(text[1:-1])]
    return _scalar(text)


def _scalar(text: str) -> Any:
    if text.startswith('"'):
        return json.loads(text)
    if text in CONSTANTS:
        return CONSTANTS[text]
    if number := NUMBER.fullmatch(text):
        return float(text) if number[1] or number[2] else int(text)
    return text
