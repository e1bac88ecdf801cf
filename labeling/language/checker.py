"""The language that generated programs may be written in: a small part of Python.

A program is parsed, never run, here. What is not on the list is refused with its line and column
and with what to write instead, so that the message can go back to a language model for repair.
The checker is the first wall and the linter; the second wall is the sandbox, which has no host
Python inside (see the package's docstring).
"""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from codediffuser.errors import ProgramError
from codediffuser.labeling.language import allowed

ProgramKind = Literal["compose", "detect"]
"""`compose` turns an instruction into [pick, place]; `detect` a phrase into a list of instances."""

RESULT = "output_var"
"""The variable that a program answers with."""

MAX_CHARACTERS = 20_000
MAX_NODES = 4_000
MAX_DEPTH = 40
MAX_INT = 2**53
MAX_PROBLEMS = 5
"""Problems told at once."""


@dataclass(frozen=True, slots=True)
class CheckedProgram:
    """A program that the allow-list lets through."""

    kind: ProgramKind
    text: str
    tree: ast.Module


@dataclass(frozen=True, slots=True)
class Problem:
    """One place where a program leaves the language."""

    line: int
    column: int
    message: str

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.message}"


def check_program(text: str, kind: ProgramKind = "compose") -> CheckedProgram:
    """Parse a program and refuse whatever the language does not have.

    Raises:
        ProgramError: The text is no Python, too long or too deep, or leaves the language; the
            message gives line, column and remedy of up to `MAX_PROBLEMS` places.
    """
    tree = _parse(text)
    problems = list(_size_problems(tree)) or sorted(
        {(p.line, p.column, p.message): p for p in _Checker(tree, kind).problems()}.values(),
        key=lambda p: (p.line, p.column),
    )
    if problems:
        told = "; ".join(str(p) for p in problems[:MAX_PROBLEMS])
        more = len(problems) - MAX_PROBLEMS
        raise ProgramError(
            f"the program is not allowed: {told}" + (f"; and {more} more" if more > 0 else "")
        )
    return CheckedProgram(kind, text, tree)


def _parse(text: str) -> ast.Module:
    if len(text) > MAX_CHARACTERS:
        raise ProgramError(
            f"the program has {len(text)} characters, allowed are {MAX_CHARACTERS}; write less"
        )
    try:
        return ast.parse(text)
    except SyntaxError as error:
        place = f"line {error.lineno or 1}, column {error.offset or 1}"
        raise ProgramError(f"the program is no Python: {place}: {error.msg}") from None
    except (ValueError, RecursionError, MemoryError) as error:
        reason = str(error) or "nested too deeply"
        raise ProgramError(f"the program cannot be parsed: {reason}") from None


def _size_problems(tree: ast.Module) -> Iterator[Problem]:
    """Too many nodes or too deep nesting, found without recursion."""
    count, pending = 0, [(tree, 0, 1, 1)]  # type: int, list[tuple[ast.AST, int, int, int]]
    while pending:
        node, depth, line, column = pending.pop()
        line = getattr(node, "lineno", line)
        column = getattr(node, "col_offset", column - 1) + 1
        count += 1
        if count > MAX_NODES:
            yield Problem(line, column, f"the program is too long: over {MAX_NODES} parts")
            return
        if depth > MAX_DEPTH:
            yield Problem(line, column, f"nested deeper than {MAX_DEPTH}; use variables")
            return
        pending += [(child, depth + 1, line, column) for child in ast.iter_child_nodes(node)]


class _Checker:
    """Walks one tree against the tables of `allowed`."""

    def __init__(self, tree: ast.Module, kind: ProgramKind) -> None:
        self._tree = tree
        self._methods = allowed.SCENE_METHODS[kind]
        self._bound = set(_bound_names(tree))
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
        self._arguments = {id(argument) for call in calls for argument in call.args}

    def problems(self) -> Iterator[Problem]:
        """Every place that is not allowed."""
        if RESULT not in self._bound:
            last = self._tree.body[-1].lineno if self._tree.body else 1
            yield Problem(last, 1, f"nothing is assigned to `{RESULT}`, the program's answer")
        for statement in self._tree.body:
            yield from self._visit(statement)

    def _visit(self, node: ast.AST) -> Iterator[Problem]:
        name = type(node).__name__
        if name not in allowed.NODES:
            yield _problem(node, allowed.refusal(name))
            return  # What is inside is of no interest any more.
        special = getattr(self, f"_check_{name.lower()}", None)
        inner: Iterator[ast.AST] = ast.iter_child_nodes(node)
        if special is not None:
            yield from special(node)
        if isinstance(node, ast.Call):
            inner = self._parts_of_call(node)
        elif isinstance(node, ast.Attribute):
            inner = iter(() if np_path(node) is not None else (node.value,))
        for child in inner:
            yield from self._visit(child)

    def _parts_of_call(self, node: ast.Call) -> Iterator[ast.AST]:
        """Arguments, and the called expression unless its name was judged already."""
        if isinstance(node.func, ast.Attribute):
            if np_path(node.func) is None and not _is_name(node.func.value, "self"):
                yield node.func.value
        elif not isinstance(node.func, ast.Name):
            yield node.func
        yield from node.args
        yield from node.keywords

    def _check_name(self, node: ast.Name) -> Iterator[Problem]:
        name = node.id
        if name.startswith("_") and name != "_":
            yield _problem(node, f"the name `{name}` is not allowed: names cannot begin with _")
        elif isinstance(node.ctx, ast.Store):
            if name in allowed.RESERVED:
                yield _problem(node, f"`{name}` cannot be assigned; choose another name")
        elif name in ("self", "np"):
            example = "self.detect(...)" if name == "self" else "np.mean(...)"
            yield _problem(node, f"`{name}` cannot be passed around, only called as {example}")
        elif name in allowed.BUILTINS and name not in self._bound:
            yield _problem(node, f"`{name}` can only be called, as {name}(...)")
        elif name not in self._bound:
            yield _problem(node, self._unknown(name))

    def _unknown(self, name: str) -> str:
        known = sorted(self._bound | allowed.BUILTINS | {"np", "self"})
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
        if close:
            return f"unknown name `{name}`; did you mean `{close[0]}`?"
        return (
            f"unknown name `{name}`; known are the program's variables, self, np and "
            f"{', '.join(sorted(allowed.BUILTINS))}"
        )

    def _check_call(self, node: ast.Call) -> Iterator[Problem]:
        for keyword in node.keywords:
            if keyword.arg is None:
                yield _problem(keyword, "** is not allowed in calls; write each argument")
        function = node.func
        if isinstance(function, ast.Name):
            if function.id in self._bound:
                yield from self._check_name(function)
            elif function.id not in allowed.BUILTINS:
                yield _problem(function, self._unknown(function.id))
            elif function.id == "next" and not isinstance(
                node.args[0] if node.args else None, ast.GeneratorExp
            ):
                yield _problem(function, "next(...) takes (x for x in ... if ...); or use [0]")
        elif isinstance(function, ast.Attribute):
            yield from self._check_method(function)
        elif not isinstance(function, ast.Lambda):
            yield _problem(function, "only functions with a name can be called")

    def _check_method(self, function: ast.Attribute) -> Iterator[Problem]:
        path = np_path(function)
        if path is not None:
            if path not in allowed.NP_FUNCTIONS:
                yield _problem(function, _not_offered("np.", path, allowed.NP_FUNCTIONS))
        elif _is_name(function.value, "self"):
            if function.attr not in self._methods:
                yield _problem(function, _not_offered("self.", function.attr, self._methods))
        elif function.attr not in allowed.METHODS:
            yield _problem(function, _not_offered(".", function.attr, allowed.METHODS))

    def _check_attribute(self, node: ast.Attribute) -> Iterator[Problem]:
        path = np_path(node)
        if path is not None:
            if path in allowed.NP_FUNCTIONS:
                yield _problem(node, f"`np.{path}` can only be called, as np.{path}(...)")
            elif path not in allowed.NP_CONSTANTS:
                yield _problem(node, _not_offered("np.", path, allowed.NP_CONSTANTS))
        elif not isinstance(node.ctx, ast.Load):
            yield _problem(node, "attributes cannot be assigned; use a variable")
        elif node.attr not in allowed.ATTRIBUTES:
            yield _problem(node, _not_offered(".", node.attr, allowed.ATTRIBUTES))

    def _check_constant(self, node: ast.Constant) -> Iterator[Problem]:
        value = node.value
        if value is ... or isinstance(value, (bytes, complex)):
            yield _problem(node, f"constants of type {type(value).__name__} are not allowed")
        elif isinstance(value, int) and abs(value) > MAX_INT:
            yield _problem(node, "whole numbers beyond 2**53 are not allowed")

    def _check_augassign(self, node: ast.AugAssign) -> Iterator[Problem]:
        if not isinstance(node.target, ast.Name):
            yield _problem(node, "in-place operators take a plain variable; write a[i] = a[i] + b")

    def _check_assign(self, node: ast.Assign) -> Iterator[Problem]:
        if len(node.targets) > 1:
            yield _problem(node, "one assignment per line: a = b = c is not allowed")
        if not isinstance(node.targets[0], ast.Subscript):
            yield from self._names_only(node.targets[0])

    def _check_for(self, node: ast.For) -> Iterator[Problem]:
        yield from self._names_only(node.target)

    def _names_only(self, target: ast.expr) -> Iterator[Problem]:
        """Complain about targets other than names and tuples of names."""
        if isinstance(target, (ast.Tuple, ast.List)):
            for part in target.elts:
                yield from self._names_only(part)
        elif isinstance(target, ast.Subscript):
            yield _problem(target, "only plain variables can stand here; assign items separately")

    def _check_generatorexp(self, node: ast.GeneratorExp) -> Iterator[Problem]:
        if id(node) not in self._arguments:
            yield _problem(node, "a generator can only be an argument; use a list: [... for ...]")

    def _check_functiondef(self, node: ast.FunctionDef) -> Iterator[Problem]:
        if node.decorator_list or node.returns is not None:
            yield _problem(node, "functions take no decorators and no annotations")
        if node.name.startswith("_") or node.name in allowed.RESERVED:
            yield _problem(node, f"a function cannot be called `{node.name}`")

    def _check_arguments(self, node: ast.arguments) -> Iterator[Problem]:
        if node.vararg or node.kwarg or node.posonlyargs or node.kwonlyargs:
            first = (node.posonlyargs + node.kwonlyargs + [node.vararg or node.kwarg])[0]
            yield _problem(first, "functions take plain arguments only")

    def _check_arg(self, node: ast.arg) -> Iterator[Problem]:
        if node.annotation is not None:
            yield _problem(node, "annotations are not allowed")
        if node.arg in allowed.RESERVED or (node.arg.startswith("_") and node.arg != "_"):
            yield _problem(node, f"an argument cannot be called `{node.arg}`")

    def _check_dict(self, node: ast.Dict) -> Iterator[Problem]:
        if None in node.keys:
            yield _problem(node, "** is not allowed in dicts; write each entry")

    def _check_comprehension(self, node: ast.comprehension) -> Iterator[Problem]:
        yield from self._names_only(node.target)
        if node.is_async:
            yield _problem(node.target, "async is not allowed")

    def _check_keyword(self, node: ast.keyword) -> Iterator[Problem]:
        if node.arg is not None and node.arg.startswith("_"):
            yield _problem(node, f"the keyword `{node.arg}` is not allowed")


def _bound_names(tree: ast.Module) -> Iterator[str]:
    """Every name that the program gives a value to, whatever the scope."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg


def np_path(node: ast.Attribute) -> str | None:
    """`linalg.norm` for `np.linalg.norm`; None for what is not a path from `np`."""
    if _is_name(node.value, "np"):
        return node.attr
    if isinstance(node.value, ast.Attribute) and _is_name(node.value.value, "np"):
        return f"{node.value.attr}.{node.attr}"
    return None


def _is_name(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _not_offered(prefix: str, name: str, offered: frozenset[str]) -> str:
    close = difflib.get_close_matches(name, sorted(offered), n=1, cutoff=0.6)
    if close:
        return f"`{prefix}{name}` is not offered; did you mean `{prefix}{close[0]}`?"
    return f"`{prefix}{name}` is not offered; offered are {', '.join(sorted(offered))}"


def _problem(node: ast.AST | None, message: str) -> Problem:
    return Problem(getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1, message)
