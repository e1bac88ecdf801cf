"""A lowered program means what Python with NumPy means."""

from __future__ import annotations

import pytest

from codediffuser.errors import ProgramError
from codediffuser.labeling.language.checker import check_program
from codediffuser.labeling.language.instances import Instance
from codediffuser.labeling.language.lowering import lower_program
from codediffuser.labeling.language.sandbox import SceneApi, run_program

SETUP = """
a = np.array([3.0, 1.0, 2.0])
m = np.array([[1, 2, 3], [4, 5, 6]])
l = [3, 1, 2]
d = {"x": 1, "y": a}
"""


@pytest.fixture
def holds(make_scene):
    """Run statements, then say whether an expression is true."""
    thing: Instance = make_scene().instances("crate")[0]
    api = SceneApi(lambda phrase: [thing], lambda category: [thing, thing], lambda p, c: [0])

    def run(expression: str, statements: str = "") -> bool:
        text = (
            f"{SETUP}{statements}\nok = {expression}\n"
            "output_var = [self.get_obj('crate')[0] if ok else None]"
        )
        return run_program(check_program(text), api) == [thing]

    return run


TRUE = [
    # Arithmetic: plain, mixed, arrays.
    "1 + 2 * 3 - 4 / 2 == 5", "7 // 2 == 3 and 7 % 4 == 3 and 2 ** 3 == 8 and -7 // 2 == -4",
    "np.all(a + 1 == np.array([4, 2, 3]))", "np.all(1 - a == [-2, 0, -1])",
    "np.all(a * a == [9, 1, 4])", "np.all(12 / a == [4, 12, 6])", "np.all(-a == [-3, -1, -2])",
    "np.all(a ** 2 == [9, 1, 4])", "np.all(a // 2 == [1, 0, 1])", "np.all(a % 2 == [1, 1, 0])",
    "[1] + [2] == [1, 2]", "[0] * 3 == [0, 0, 0]", "'ab' + 'c' == 'abc'", "+l[0] == 3",
    # Comparison, truth, short circuits.
    "np.all((a > 1) == [True, False, True])", "np.sum(a >= 2) == 2", "np.any(a != 3)",
    "np.all((a < 3) & (a > 1) == [False, False, True])", "np.all(~(a > 1) == [0, 1, 0])",
    "np.sum((a < 2) | (a > 2)) == 2", "0 < 1 < 2", "not 0 < 2 < 1", "1 < 2 == 2 != 3",
    "(0 or 5) == 5", "(0 and 1 / 0) == 0", "(3 or 1 / 0) == 3", "(2 > 3 > 1 / 0) == False",
    "None is None and l is not None", "2 in l and 9 not in l", "2.0 in a and 9 not in a",
    "'x' in d and 'z' not in d", "(5 if np.max(a) > 2 else 1 / 0) == 5", "not np.array([0])",
    # Indexing.
    "a[0] == 3 and a[-1] == 2", "np.all(a[1:] == [1, 2]) and np.all(a[::-1] == [2, 1, 3])",
    "l[0] == 3 and l[-2:] == [1, 2] and l[::-1] == [2, 1, 3]", "np.all(m[:, 0] == [1, 4])",
    "m[1, 2] == 6 and m[1][2] == 6", "m[None].shape == (1, 2, 3)", "a[:, None].shape == (3, 1)",
    "a[np.newaxis, :].shape == (1, 3)", "np.all(a[a > 1] == [3, 2])", "np.all(a[[0, 2]] == [3, 2])",
    "np.all(a[np.argsort(a)] == [1, 2, 3])", "l[np.argmin(a)] == 1", "d['x'] == 1",
    "np.all(m[:, 1:] == [[2, 3], [5, 6]])", "m[0, ::2].tolist() == [1, 3]", "'abc'[1] == 'b'",
    "np.where(a > 1)[0].tolist() == [0, 2]", "np.where(a > 1)[0][1] == 2",
    # Attributes and methods.
    "m.shape == (2, 3) and m.size == 6 and m.ndim == 2 and m.T.shape == (3, 2)",
    "m.mean(axis=0).tolist() == [2.5, 3.5, 4.5]", "m.sum() == 21 and m.max(axis=1)[0] == 3",
    "a.argmin() == 1 and a.copy()[0] == 3", "m.reshape(3, 2).shape == m.reshape((3, 2)).shape",
    "m.flatten().shape == (6,)", "np.max(a).item() == 3",
    # Built-ins over arrays and lists.
    "len(a) == 3 and len(m) == 2 and len(l) == 3 and len(d) == 2", "abs(-2) == 2",
    "np.all(abs(-a) == a)", "max(a) == 3 and min(l) == 1 and max(1, 2) == 2", "sum(l) == 6",
    "max(l, key=lambda v: -v) == 1", "min([], default=7) == 7", "sum(a) == 6",
    "np.all(sum([a, a]) == 2 * a)", "any([0, a[0] > 2]) and not all(a > 1)",
    "sorted(a) == [1, 2, 3] and sorted(l, reverse=True) == [3, 2, 1]", "list(a) == [3, 1, 2]",
    "[i * v for i, v in enumerate(a)] == [0, 1, 4]", "list(zip(l, a)) == [(3, 3), (1, 1), (2, 2)]",
    "[x + y for x, y, z in m] == [3, 9]", "[x for i, (x, y, z) in enumerate(m)] == [1, 4]",
    "list(reversed(l)) == [2, 1, 3]", "next((v for v in l if v < 3), None) == 1",
    "next((v for v in l if v > 9), None) is None", "int(a[0]) == 3 and float(2) == 2.0",
    "int(np.array([4.7])) == 4", "round(2.567, 1) == 2.6", "bool(l) and not bool([])",
    "{k: v for k, v in zip(['p', 'q'], l)}['q'] == 1", "tuple(a)[1] == 1", "range(3)[2] == 2",
    # Constants.
    "np.inf > 1e300 and -np.inf < 0", "3.14 < np.pi < 3.15", "np.isnan(np.nan)",
]  # fmt: skip


@pytest.mark.parametrize("expression", TRUE)
def test_expressions_mean_what_python_means(expression: str, holds) -> None:
    assert holds(expression)


STATEMENTS = {
    "x, (y, z) = 1, (2, 3)": "(x, y, z) == (1, 2, 3)",
    "x, y, z = a": "(x, y, z) == (3, 1, 2)",
    "p, q = m": "p.sum() == 6 and q.sum() == 15",
    "x = 1\nx += 2\nx *= 4": "x == 12",
    "k = l\nk += [9]": "l == [3, 1, 2, 9]",
    "b = a\nb += 1": "np.all(a == [4, 2, 3])",
    "b = a\nb = b + 1": "np.all(a == [3, 1, 2])",
    "v = m[:, 0]\nv[0] = 9": "m[0, 0] == 9",
    "a[a > 2] = 0\na[-1] = 5": "a.tolist() == [0, 1, 5]",
    "l[0] = 7\nd['z'] = 8": "l[0] == 7 and d['z'] == 8",
    "l.append(a)\nl.extend(a)": "len(l) == 7",
    "t = 0\nfor v in a:\n    t += v": "t == 6",
    "t = 0\nfor row in m:\n    t += row[0]": "t == 5",
    "t = 0\nfor x, y, z in m:\n    t += y": "t == 7",
    "t = 0\nfor i in range(9):\n  if i == 1:\n    continue\n  if i > 3:\n    break\n  t += i": (
        "t == 5"
    ),
    "for i in []:\n    pass\nelse:\n    w = 1": "w == 1",
    "def f(p, q=2):\n    if p > 1:\n        return p * q\n    return a": (
        "f(3) == 6 and f(2, q=5) == 10"
    ),
    "fs = lambda v: np.mean(v)": "fs(a) == 2",
    "if a[0] > 2 and np.any(m > 5):\n    w = 1\nelif l:\n    w = 2\nelse:\n    w = 3": "w == 1",
    "xs = [lambda: i for i in range(1)]\ni = 5": "i == 5",
    "o = self.get_obj('crate')": (
        "o[0] == o[1] and o[0]['pcd'].shape == (8, 3) and o.index(o[1]) == 0"
    ),
}  # fmt: skip


@pytest.mark.parametrize("statements", STATEMENTS)
def test_statements_mean_what_python_means(statements: str, holds) -> None:
    assert holds(STATEMENTS[statements], statements)


FAILS = {
    "1 / 0": "ZeroDivisionError",
    "l[9]": "IndexError",
    "d['nope']": "KeyError",
    "a if a > 1 else 0": "truth of an array of shape",
    "l[a]": "np.array",
    "l[:, 0]": "TypeError",
    "l.mean()": "use np.mean",
    "l.shape": "make it one first: np.array",
    "np.mean([])": "empty array",
    "np.argmin([])": "empty array",
    "np.mean(d)": "arrays hold numbers, got dict",
    "np.mean(a, axis=5)": "axis 5",
    "np.mean(a, out=a)": "'out' is not offered",
    "np.array([1, 'x'])": "arrays hold numbers, got str",
    "np.array([[1], [1, 2]])": "inhomogeneous",
    "a + np.array([1, 2])": "shape",
    "np.mean(self.get_obj('crate')[0])": "object's points are in",
    "self.get_obj('crate')[0]['pointer'] + 1": "TypeError",
    "max([])": "ValueError",
    "next(i for i in [])": "nothing is left",
}


@pytest.mark.parametrize("expression", FAILS)
def test_failures_name_the_line_and_the_cause(expression: str, holds) -> None:
    with pytest.raises(ProgramError) as caught:
        holds(expression)
    assert "in line 7" in str(caught.value)
    assert FAILS[expression] in str(caught.value)


def test_points_of_objects_cannot_be_changed(holds) -> None:
    with pytest.raises(ProgramError, match="read-only"):
        holds("True", "self.get_obj('crate')[0]['pcd'][0] = 1")


def test_unpacking_needs_as_many_names_as_values(holds) -> None:
    with pytest.raises(ProgramError, match="2 names for 3 values"):
        holds("True", "x, y = a")


def test_lines_point_back_to_the_program_as_written() -> None:
    program = check_program(
        "# one\n\nx = [\n    1,\n]\n\ndef f():\n    # two\n    return x\n\noutput_var = f()"
    )
    lowered = lower_program(program)
    texts = lowered.text.split("\n")
    found = {texts[new - 1].strip().split(" ")[0]: old for new, old in lowered.lines.items()}
    assert found == {"x": 3, "def": 7, "return": 9, "output_var": 11}
