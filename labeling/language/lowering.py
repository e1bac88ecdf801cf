"""Turn a checked program into one that the sandbox can run with arrays living outside.

Operators, comparisons, subscripts, truth tests, iteration and the built-in functions become calls
of `prelude.py`; `np.x(...)` and `self.x(...)` become calls of one host function. The meaning stays
that of Python with NumPy, with one exception: generator expressions are made whole at once.
"""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass

from codediffuser.labeling.language import allowed
from codediffuser.labeling.language.checker import CheckedProgram, np_path

HOST = "_host"

_BINARY = {
    ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "truediv", ast.FloorDiv: "floordiv",
    ast.Mod: "mod", ast.Pow: "pow", ast.BitAnd: "and", ast.BitOr: "or", ast.BitXor: "xor",
}  # fmt: skip
_COMPARE = {
    ast.Eq: "eq", ast.NotEq: "ne", ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge",
}  # fmt: skip

_OF_ITERABLES = frozenset({"enumerate", "list", "reversed", "sorted", "tuple", "zip"})
"""Built-ins that stay and get their arrays as lists."""
_OF_VALUES = frozenset({
    "abs", "all", "any", "bool", "float", "int", "len", "max", "min", "next", "round", "sum",
})  # fmt: skip
"""Built-ins that the prelude replaces."""

_CONSTANTS = {"inf": math.inf, "nan": math.nan, "pi": math.pi, "newaxis": None}


@dataclass(frozen=True, slots=True)
class LoweredProgram:
    """What the sandbox runs."""

    text: str
    lines: dict[int, int]
    """Line of a lowered statement to the line of the program it came from."""


def lower_program(program: CheckedProgram) -> LoweredProgram:
    """Lower the operators of a checked program."""
    tree = _Lowering().visit(ast.parse(program.text))
    ast.fix_missing_locations(tree)
    text = ast.unparse(tree)
    # Unparsing changes lines but not the order of the statements, so the two trees walk in step.
    lines = {
        new.lineno: old.lineno
        for old, new in zip(ast.walk(tree), ast.walk(ast.parse(text)), strict=True)
        if isinstance(old, ast.stmt) and isinstance(new, ast.stmt)
    }
    return LoweredProgram(text, lines)


def _call(name: str, *args: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(args), [])


def _later(expression: ast.expr) -> ast.Lambda:
    """The expression as a function without arguments, for what Python evaluates only if needed."""
    nothing = ast.arguments([], [], None, [], [], None, [])
    return ast.Lambda(nothing, expression)


def _text(value: str) -> ast.Constant:
    return ast.Constant(value)


class _Lowering(ast.NodeTransformer):
    """One method for each kind of node that changes."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        return _call("_op", _text(_BINARY[type(node.op)]), node.left, node.right)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.op, ast.Not):
            node.operand = _call("_truth", node.operand)
        elif isinstance(node.op, ast.Invert):
            return _call("_invert", node.operand)
        elif not isinstance(node.operand, ast.Constant):
            return _call("_neg", node.operand) if isinstance(node.op, ast.USub) else node.operand
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        name = "_and" if isinstance(node.op, ast.And) else "_or"
        return _call(name, *(_later(value) for value in node.values))

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        if len(node.ops) == 1:
            return self._compare(node.ops[0], node.left, node.comparators[0])
        a, b = ast.Name("_a", ast.Load()), ast.Name("_b", ast.Load())
        pair = ast.arguments([], [ast.arg("_a"), ast.arg("_b")], None, [], [], None, [])
        steps = [
            ast.Tuple([ast.Lambda(pair, self._compare(op, a, b)), _later(operand)], ast.Load())
            for op, operand in zip(node.ops, node.comparators, strict=True)
        ]
        return _call("_chain", node.left, *steps)

    def _compare(self, op: ast.cmpop, left: ast.expr, right: ast.expr) -> ast.expr:
        if isinstance(op, (ast.Is, ast.IsNot)):
            return ast.Compare(left, [op], [right])
        if isinstance(op, ast.In):
            return _call("_in", left, right)
        if isinstance(op, ast.NotIn):
            return ast.UnaryOp(ast.Not(), _call("_in", left, right))
        return _call("_cmp", _text(_COMPARE[type(op)]), left, right)

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.slice, ast.Slice):
            return _call("_slice", node.value, *self._slice_parts(node.slice))
        return _call("_get", node.value, self._key(node.slice))

    def _key(self, key: ast.expr) -> ast.expr:
        """The index as a value: slices become tuples that begin with "slice"."""
        if isinstance(key, ast.Slice):
            return ast.Tuple([_text("slice"), *self._slice_parts(key)], ast.Load())
        if isinstance(key, ast.Tuple):
            return ast.Tuple([self._key(part) for part in key.elts], ast.Load())
        return key

    def _slice_parts(self, part: ast.Slice) -> list[ast.expr]:
        return [part_ or ast.Constant(None) for part_ in (part.lower, part.upper, part.step)]

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        if isinstance(node.value, ast.Name) and node.value.id == "np":
            value = _CONSTANTS[node.attr]
            if value is None or math.isfinite(value):
                return ast.Constant(value)
            return _call("float", _text(str(value)))  # A literal inf or nan has no spelling.
        self.generic_visit(node)
        return _call("_attr", node.value, _text(node.attr))

    def visit_Call(self, node: ast.Call) -> ast.expr:
        node.args = [self.visit(argument) for argument in node.args]
        node.keywords = [self.visit(keyword) for keyword in node.keywords]
        function = node.func
        if isinstance(function, ast.Attribute):
            return self._method(node, function)
        if isinstance(function, ast.Name):
            if function.id in _OF_ITERABLES:
                node.args = [_call("_iter", argument) for argument in node.args]
            elif function.id in _OF_VALUES:
                function.id = f"_{function.id}"
            return node
        node.func = self.visit(function)
        return node

    def _method(self, node: ast.Call, function: ast.Attribute) -> ast.expr:
        path = np_path(function)
        on_self = isinstance(function.value, ast.Name) and function.value.id == "self"
        if path is not None or on_self:
            served = f"np.{path}" if path is not None else f"self.{function.attr}"
            return ast.Call(ast.Name(HOST, ast.Load()), [_text(served), *node.args], node.keywords)
        owner = self.visit(function.value)
        if function.attr in allowed.ARRAY_METHODS:
            lowered = _call("_method", owner, _text(function.attr), *node.args)
            lowered.keywords = node.keywords
            return lowered
        if function.attr == "extend":
            node.args = [_call("_iter", argument) for argument in node.args]
        function.value = owner
        return node

    def visit_GeneratorExp(self, node: ast.GeneratorExp) -> ast.expr:
        self.generic_visit(node)
        return ast.ListComp(node.elt, node.generators)

    def visit_comprehension(self, node: ast.comprehension) -> ast.comprehension:
        self.generic_visit(node)
        node.iter = self._loop(node.iter, node.target)
        node.ifs = [_call("_truth", test) for test in node.ifs]
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        self.generic_visit(node)
        node.test = _call("_truth", node.test)
        return node

    def visit_If(self, node: ast.If) -> ast.stmt:
        self.generic_visit(node)
        node.test = _call("_truth", node.test)
        return node

    def visit_For(self, node: ast.For) -> ast.stmt:
        self.generic_visit(node)
        node.iter = self._loop(node.iter, node.target)
        return node

    def _loop(self, iterable: ast.expr, target: ast.expr) -> ast.expr:
        """What a loop runs over; with several loop variables, each item unpacked beforehand."""
        items = _call("_iter", iterable)
        if isinstance(target, ast.Name):
            return items
        item = ast.Name("_item", ast.Store())
        unpacked = _call("_unpack", ast.Name("_item", ast.Load()), self._pattern(target))
        return ast.ListComp(unpacked, [ast.comprehension(item, items, [], 0)])

    def _pattern(self, target: ast.expr) -> ast.expr:
        if isinstance(target, (ast.Tuple, ast.List)):
            return ast.Tuple([self._pattern(part) for part in target.elts], ast.Load())
        return ast.Constant(None)

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:
        target = node.targets[0]
        value = self.visit(node.value)
        if isinstance(target, ast.Subscript):
            owner, key = self.visit(target.value), self._key(self.visit(target.slice))
            return ast.copy_location(ast.Expr(_call("_set", owner, key, value)), node)
        if isinstance(target, (ast.Tuple, ast.List)):
            value = _call("_unpack", value, self._pattern(target))
        node.value = value
        return node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        assert isinstance(node.target, ast.Name)  # The checker let it through.
        name = node.target.id
        value = _call(
            "_iop",
            _text(_BINARY[type(node.op)]),
            ast.Name(name, ast.Load()),
            self.visit(node.value),
        )
        return ast.copy_location(ast.Assign([ast.Name(name, ast.Store())], value), node)
