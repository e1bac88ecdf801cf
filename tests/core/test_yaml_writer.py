import io
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from codediffuser.yaml_writer import dump_yaml

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
SCALARS = st.none() | st.booleans() | st.integers() | TEXT | st.floats(allow_nan=False)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=12,
)


def read(text: str) -> Any:
    return YAML(typ="safe", pure=True).load(io.StringIO(text))


@given(VALUES)
def test_what_is_written_is_read_back(value: Any) -> None:
    assert read(dump_yaml(value)) == value


@pytest.mark.parametrize(
    "text",
    ["", "no", "True", "null", "~", "1", "1.5", "0o7", "1e3", "1_000", "000042", " a", "a ", "a: b",
     "a #b", "- a", "[a", "{a", "a,b", "it's", 'a "b"', "\\", "2026-01-01", ".inf", "é", "\u2028",
     "\x85", "\x7f", "\U0001f600", "a\nb", "<<", "=", "!a", "&a", "*a", "%a", "@a", "`a", "..."],
)  # fmt: skip
def test_strings_stay_strings(text: str) -> None:
    assert read(dump_yaml({"key": text, "list": [text], text: 1})) == {
        "key": text, "list": [text], text: 1,
    }  # fmt: skip


@pytest.mark.parametrize("number", [1e-07, -2.5e300, 0.1, 1e22, -0.0, math.inf, 5e-324])
def test_floats_keep_every_bit(number: float) -> None:
    assert read(dump_yaml([number])) == [number]
    assert math.isnan(read(dump_yaml([math.nan]))[0])


def test_the_text_is_made_for_people() -> None:
    value = {
        "name": "a red mug",
        "at": [0.5, 0, -1.25],
        "parts": [{"id": "x", "of": None}],
        "none": {},
    }
    assert dump_yaml(value) == (
        "name: a red mug\nat: [0.5, 0, -1.25]\nparts:\n- id: x\n  of: null\nnone: {}\n"
    )


def test_other_types_are_refused() -> None:
    with pytest.raises(TypeError, match="cannot write set as YAML"):
        dump_yaml({"a": {1}})
