"""What programs may use: kinds of syntax, functions, methods and attributes, as plain tables.

`checker.py` judges by these tables, `facade.py` offers what they name under `np`, and `prompts.py`
tells them to language models. A test keeps the three together.
"""

from __future__ import annotations

NODES = frozenset({
    # Statements.
    "Assign", "AugAssign", "Break", "Continue", "Expr", "For", "FunctionDef", "If", "Pass",
    "Return",
    # Expressions.
    "Attribute", "BinOp", "BoolOp", "Call", "Compare", "Constant", "Dict", "DictComp",
    "GeneratorExp", "IfExp", "Lambda", "List", "ListComp", "Name", "Slice", "Subscript", "Tuple",
    "UnaryOp",
    # Parts of them.
    "arg", "arguments", "comprehension", "keyword", "Load", "Store",
    "Add", "Sub", "Mult", "Div", "FloorDiv", "Mod", "Pow", "BitAnd", "BitOr", "BitXor",
    "USub", "UAdd", "Not", "Invert", "And", "Or",
    "Eq", "NotEq", "Lt", "LtE", "Gt", "GtE", "Is", "IsNot", "In", "NotIn",
})  # fmt: skip
"""Names of the `ast` classes that the language has."""

_ADVICE = {
    "Import": "imports are not allowed; np is there already",
    "ImportFrom": "imports are not allowed; np is there already",
    "While": "`while` is not allowed; use `for` over a list or range(...)",
    "Try": "`try` is not allowed; test with `if` first",
    "TryStar": "`try` is not allowed; test with `if` first",
    "With": "`with` is not allowed: programs reach no files",
    "Raise": "`raise` is not allowed; answer with None for what is not there",
    "Assert": "`assert` is not allowed; use `if`",
    "ClassDef": "classes are not allowed; use lists and dicts",
    "JoinedStr": "f-strings are not allowed; programs answer with objects, not with text",
    "NamedExpr": "`:=` is not allowed; assign on a line of its own",
    "AnnAssign": "annotations are not allowed; write name = value",
    "Starred": "* is not allowed here; write each item",
    "Delete": "`del` is not allowed",
    "Global": "`global` is not allowed; pass arguments",
    "Nonlocal": "`nonlocal` is not allowed; pass arguments",
    "SetComp": "sets are not allowed; use a list",
    "Set": "sets are not allowed; use a list",
    "MatMult": "@ is not allowed; use np.dot",
    "LShift": "shifts are not allowed",
    "RShift": "shifts are not allowed",
}

BUILTINS = frozenset({
    "abs", "all", "any", "bool", "enumerate", "float", "int", "len", "list", "max", "min", "next",
    "range", "reversed", "round", "sorted", "sum", "tuple", "zip",
})  # fmt: skip
"""Built-in functions that can be called."""

RESERVED = BUILTINS | {"self", "np"}
"""Names that keep their meaning."""

SCENE_METHODS = {
    "compose": frozenset({"detect", "get_obj", "find_instance_in_category"}),
    # A detection program that called `detect` would ask for itself.
    "detect": frozenset({"get_obj", "find_instance_in_category"}),
}
"""What can be called on `self`, by the kind of program."""

ARRAY_METHODS = frozenset({
    "all", "any", "argmax", "argmin", "argsort", "copy", "flatten", "item", "max", "mean", "min",
    "ravel", "reshape", "round", "squeeze", "std", "sum", "tolist",
})  # fmt: skip
"""Methods of arrays."""

NATIVE_METHODS = frozenset({
    "append", "count", "endswith", "extend", "get", "index", "insert", "items", "keys", "lower",
    "pop", "remove", "sort", "split", "startswith", "strip", "values",
})  # fmt: skip
"""Methods of lists, dicts and text. `str.format` stays out: its fields reach attributes."""

METHODS = ARRAY_METHODS | NATIVE_METHODS

ATTRIBUTES = frozenset({"T", "ndim", "shape", "size"})
"""Attributes of arrays."""

NP_CONSTANTS = frozenset({"inf", "nan", "newaxis", "pi"})

NP_REDUCTIONS = frozenset({
    "all", "amax", "amin", "any", "argmax", "argmin", "average", "max", "mean", "median", "min",
    "percentile", "ptp", "std", "sum", "var", "linalg.norm",
})  # fmt: skip

NP_ELEMENTWISE = frozenset({
    "abs", "absolute", "add", "arctan2", "ceil", "clip", "cos", "divide", "equal", "exp", "floor",
    "greater", "greater_equal", "hypot", "isclose", "isfinite", "isnan", "less", "less_equal",
    "logical_and", "logical_not", "logical_or", "maximum", "minimum", "multiply", "negative",
    "not_equal", "power", "round", "sign", "sin", "sqrt", "square", "subtract", "where",
})  # fmt: skip

NP_SHAPING = frozenset({
    "allclose", "arange", "argsort", "argwhere", "array", "asarray", "atleast_1d", "atleast_2d",
    "column_stack", "concatenate", "count_nonzero", "cross", "cumsum", "diff", "dot",
    "expand_dims", "flatnonzero", "flip", "full", "hstack", "linspace", "nonzero", "ones", "ravel",
    "reshape", "sort", "squeeze", "stack", "transpose", "unique", "vstack", "zeros",
})  # fmt: skip

NP_FUNCTIONS = NP_REDUCTIONS | NP_ELEMENTWISE | NP_SHAPING
"""What can be called on `np`."""


def refusal(node_name: str) -> str:
    """Say why a kind of syntax is refused and what to use in its place."""
    return _ADVICE.get(node_name, f"syntax `{node_name}` is not allowed; use a simpler form")
