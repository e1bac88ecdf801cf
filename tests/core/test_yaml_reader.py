from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codediffuser.datagen.scene import SceneSpec
from codediffuser.yaml_reader import read_own_yaml
from codediffuser.yaml_writer import dump_yaml

TEXT = st.text("ab \"\\'-:#,[]{}\n1.éx", max_size=8)
SCALARS = st.none() | st.booleans() | st.integers() | TEXT | st.floats(allow_nan=False)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(TEXT, VALUES, min_size=1, max_size=4))
def test_what_is_read_is_what_was_written_or_nothing(value: dict[str, Any]) -> None:
    found = read_own_yaml(dump_yaml(value))
    assert found is None or (found == value and repr(found) == repr(value))


def test_a_scene_file_is_read(small_scene: SceneSpec) -> None:
    raw = small_scene.model_dump(mode="json", by_alias=True)
    assert read_own_yaml(dump_yaml(raw)) == raw


@pytest.mark.parametrize(
    "text",
    ["", "a", "a: 1", "a: 'b'\n", "a: yes\n", "a: 1 # one\n", "# one\na: 1\n", "a: [1,2]\n",
     "a:\n  - 1\n", "a: {b: 1}\n", "a: 0x1f\n", "a: 1e3\n", "a: |\n  b\n", "a: 1\na: 2\n",
     "a: &x 1\n", "a: 1\r\n", "a:  1\n", "- a\n", "a:\n", "a: ~\n", "\ta: 1\n", "a: \"\\q\"\n"],
)  # fmt: skip
def test_every_other_dialect_is_left_to_the_parser(text: str) -> None:
    assert read_own_yaml(text) is None
