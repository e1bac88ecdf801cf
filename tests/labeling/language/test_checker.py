from __future__ import annotations

import ast
import re
import time
from pathlib import Path

import pytest

import codediffuser.labeling.language as language
from codediffuser.errors import ProgramError
from codediffuser.labeling.language import allowed
from codediffuser.labeling.language.checker import check_program

REFUSED = {
    "import os\noutput_var = []": "line 1, column 1: imports are not allowed",
    "from os import path\noutput_var = []": "imports are not allowed",
    "output_var = []\nwhile True:\n    pass": "line 2, column 1: `while` is not allowed; use `for`",
    "output_var = __import__('os')": "unknown name `__import__`",
    "output_var = ().__class__.__bases__": "is not offered",
    "output_var = self.__class__": "`.__class__` is not offered",
    "output_var = self": "`self` cannot be passed around",
    "output_var = np": "`np` cannot be passed around",
    "output_var = np.load('x')": "`np.load` is not offered",
    "output_var = np.linalg.nrom(1)": "did you mean `np.linalg.norm`",
    "output_var = np.mean": "can only be called",
    "output_var = np.lib.npyio": "is not offered",
    "output_var = '{0.__class__}'.format(1)": "`.format` is not offered",
    "output_var = f'{1}'": "f-strings are not allowed",
    "output_var = getattr(1, 'real')": "unknown name `getattr`",
    "output_var = eval('1')": "unknown name `eval`",
    "output_var = open('/etc/passwd').read()": "unknown name `open`",
    "output_var = print(1)": "unknown name `print`",
    "output_var = globals()": "unknown name `globals`",
    "output_var = detct": "unknown name `detct`",
    "output_var = self.detct('a')": "did you mean `self.detect`",
    "output_var = [].apend(1)": "did you mean `.append`",
    "x = 1": "nothing is assigned to `output_var`",
    "": "nothing is assigned to `output_var`",
    "output_var = (x := 1)": "`:=` is not allowed",
    "output_var: list = []": "annotations are not allowed",
    "class A:\n    output_var = 1": "classes are not allowed",
    "try:\n    output_var = 1\nexcept Exception:\n    pass": "`try` is not allowed",
    "with open('x') as f:\n    output_var = 1": "`with` is not allowed",
    "output_var = [*[1], 2]": "write each item",
    "output_var = dict(**{})": "unknown name `dict`",
    "output_var = max(**{})": "** is not allowed",
    "output_var = {**{}}": "** is not allowed",
    "output_var = b'x'": "type bytes",
    "output_var = 2j": "type complex",
    "output_var = 99999999999999999999": "beyond 2**53",
    "self = 1\noutput_var = 1": "`self` cannot be assigned",
    "len = 1\noutput_var = 1": "`len` cannot be assigned",
    "for np in [1]:\n    output_var = 1": "`np` cannot be assigned",
    "_host = 1\noutput_var = 1": "names cannot begin with _",
    "def _op(a):\n    return 1\noutput_var = 1": "cannot be called `_op`",
    "output_var = (lambda _a: 1)(1)": "cannot be called `_a`",
    "def len(a):\n    return 1\noutput_var = 1": "cannot be called `len`",
    "@abs\ndef f(a):\n    return 1\noutput_var = 1": "no decorators",
    "def f(*a):\n    return 1\noutput_var = 1": "plain arguments only",
    "output_var = 1\noutput_var.x = 2": "attributes cannot be assigned",
    "d = {}\nd['a'] += 1\noutput_var = d": "plain variable",
    "a = b = 1\noutput_var = a": "one assignment per line",
    "g = (i for i in [1])\noutput_var = g": "a generator can only be an argument",
    "output_var = next([1])": "next(...) takes",
    "x = [1]\nfor x[0] in [2]:\n    pass\noutput_var = x": "plain variables",
    "output_var = [f for f in [1]][0](2)": "only functions with a name",
    "del output_var\noutput_var = 1": "`del` is not allowed",
    "global x\noutput_var = 1": "`global` is not allowed",
    "async def f():\n    pass\noutput_var = 1": "not allowed",
    "output_var = (": "no Python: line 1, column 14",
    "output_var = 'a\0b'": "null bytes",
    "output_var = " + "9" * 5_000: "no Python",
    "output_var = " + "-" * 10_000 + "1": "cannot be parsed",
    "output_var = " + "[" * 60 + "]" * 60: "nested deeper than",
    "output_var = [" + "1, " * 5_000 + "]": "too long",
    "output_var = 1 # " + "x" * 30_000: "characters",
}


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: repr(text[:40]))
def test_what_the_language_lacks_is_refused_with_its_place(text: str) -> None:
    began = time.perf_counter()
    with pytest.raises(ProgramError) as caught:
        check_program(text)
    assert REFUSED[text] in str(caught.value)
    assert "\n" not in str(caught.value)
    assert time.perf_counter() - began < 2.0


def test_scene_functions_depend_on_the_kind_of_program() -> None:
    text = "output_var = self.detect('battery')"
    check_program(text, "compose")
    with pytest.raises(ProgramError, match=r"`self.detect` is not offered"):
        check_program(text, "detect")


def test_several_problems_are_told_at_once_in_order() -> None:
    text = "output_var = foo\nimport os\nx = bar\n" + "y = baz\n" * 9
    with pytest.raises(ProgramError) as caught:
        check_program(text)
    lines = [int(n) for n in re.findall(r"line (\d+)", str(caught.value))]
    assert lines == [1, 2, 3, 4, 5] and "and 7 more" in str(caught.value)


def test_ordinary_programs_pass() -> None:
    check_program(
        "def center(obj, axis=0):\n"
        "    '''Mean.'''\n"
        "    return obj['pcd'].mean(axis=axis)\n"
        "found = sorted(self.detect('slot'), key=lambda obj: center(obj)[0])\n"
        "first = next((o for i, o in enumerate(found) if 0 <= i < 3 and o is not None), None)\n"
        "n = {'a': 1}\nn['b'] = -n['a']\n"
        "best, _ = (first, 1) if found else (None, 0)\n"
        "output_var = [best, found[-1]['pointer']]\n"
    )


def test_no_module_of_the_package_runs_text_as_python() -> None:
    for path in Path(language.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("exec", "eval", "compile", "__import__"), path


def test_lists_of_allowed_things_name_nothing_private() -> None:
    for names in (allowed.METHODS, allowed.ATTRIBUTES, allowed.NP_FUNCTIONS, allowed.BUILTINS):
        assert not [name for name in names if name.startswith("_")]
    assert not allowed.METHODS & {"format", "format_map", "tofile", "dump", "data"}
