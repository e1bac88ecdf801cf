from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import pytest
from pydantic import ValidationError

from codediffuser.errors import ConfigError, SchemaVersionError
from codediffuser.schema import Document, Raw, Strict, dump_yaml, load_yaml


class Wheel(Strict):
    radius_m: float
    color_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Cart(Document):
    """A document at its second version: version 1 called `wheels` `rolls`."""

    KIND: ClassVar[str] = "cart"
    VERSION: ClassVar[int] = 2

    name: str
    wheels: tuple[Wheel, ...] = ()
    spare: Wheel | None = None

    @staticmethod
    def _upgrade_1_to_2(raw: Raw) -> Raw:
        return {("wheels" if key == "rolls" else key): value for key, value in raw.items()}


Cart.UPGRADES = {1: Cart._upgrade_1_to_2}

Load = Callable[..., Cart]

CART = "schema: codediffuser.cart/2\nname: barrow\nwheels:\n- {radius_m: 0.2}\n"


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def load_text(text: str, name: str = "cart.yaml") -> Cart:
        path = tmp_path / name
        path.write_text(text)
        return Cart.load(path)

    return load_text


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_saved_document_loads_as_it_was(tmp_path: Path, suffix: str) -> None:
    cart = Cart(name="Ümläut: #1", wheels=(Wheel(radius_m=0.2), Wheel(radius_m=1e-7)))
    path = tmp_path / f"cart{suffix}"
    cart.save(path)
    assert Cart.load(path) == cart


def test_saving_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = tmp_path / "a.yaml", tmp_path / "b.yaml"
    Cart(name="barrow", wheels=(Wheel(radius_m=0.2),)).save(first)
    Cart.load(first).save(second)
    assert first.read_bytes() == second.read_bytes()


def test_the_schema_is_the_first_line_and_the_newest(tmp_path: Path) -> None:
    path = tmp_path / "cart.yaml"
    Cart(name="barrow").save(path)
    assert path.read_text().splitlines()[0] == "schema: codediffuser.cart/2"


def test_an_old_version_is_lifted(load: Load) -> None:
    cart = load("schema: codediffuser.cart/1\nname: barrow\nrolls:\n- {radius_m: 0.2}\n")
    assert cart.wheels[0].radius_m == 0.2
    assert cart.schema_ == "codediffuser.cart/2"


@pytest.mark.parametrize(
    ("first_line", "message"),
    [
        ("schema: codediffuser.cart/3", "newer than this codediffuser.*'codediffuser.cart/2'"),
        ("schema: codediffuser.scene/1", "expected schema 'codediffuser.cart/2', got"),
        ("schema: codediffuser.cart", "expected schema 'codediffuser.cart/2', got"),
        ("schema: codediffuser.cart/0", "no longer readable"),
        ("", "'schema: codediffuser.cart/2' is missing; add it as the first line"),
    ],
)
def test_another_schema_is_refused_by_name(load: Load, first_line: str, message: str) -> None:
    with pytest.raises(SchemaVersionError, match=message):
        load(f"{first_line}\nname: barrow\n")


def test_an_unknown_key_is_answered_with_the_closest_and_all(load: Load) -> None:
    with pytest.raises(ConfigError) as caught:
        load(CART + "whels: []\n")
    message = str(caught.value)
    assert "cart.yaml: unknown key 'whels'; did you mean 'wheels'?" in message
    assert "Known keys: name, schema, spare, wheels." in message


@pytest.mark.parametrize(
    "where", ["wheels:\n- {radius_m: 1, colour_rgb: 1}", "spare: {radius_m: 1, colour_rgb: 1}"]
)
def test_an_unknown_key_deep_inside_is_answered_with_its_neighbours(load: Load, where: str) -> None:
    with pytest.raises(ConfigError, match=r"colour_rgb'; did you mean 'color_rgb'\?"):
        load(f"schema: codediffuser.cart/2\nname: barrow\n{where}\n")


def test_every_complaint_is_told_at_once_with_its_address(load: Load) -> None:
    with pytest.raises(ConfigError) as caught:
        load("schema: codediffuser.cart/2\nwheels:\n- {radius_m: wide}\n")
    message = str(caught.value)
    assert "key 'name' is missing" in message
    assert "key 'wheels.0.radius_m'" in message and "got 'wide'" in message
    assert "\n" not in message


def test_a_key_given_twice_is_refused(load: Load) -> None:
    with pytest.raises(ConfigError, match=r"cart\.yaml:5:1"):
        load(CART + "name: lorry\n")


def test_a_file_that_is_no_yaml_is_named_with_line_and_column(load: Load) -> None:
    with pytest.raises(ConfigError, match=r"cart\.yaml:2:\d+: not YAML"):
        load("schema: codediffuser.cart/2\nname: [unclosed]]\n")


def test_a_file_that_is_no_json_is_named_with_line_and_column(load: Load) -> None:
    with pytest.raises(ConfigError, match=r"cart\.json:1:2: not JSON"):
        load("{name}", "cart.json")


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "just words"])
def test_a_file_without_a_mapping_at_the_top_is_refused(load: Load, text: str) -> None:
    with pytest.raises(ConfigError, match="expected a mapping at the top"):
        load(text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml: no such cart file"):
        Cart.load(tmp_path / "none.yaml")


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cart.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot be read as a cart file"):
        Cart.load(path)


def test_a_parsed_document_does_not_change() -> None:
    cart = Cart(name="barrow")
    with pytest.raises(ValidationError, match="frozen"):
        cart.name = "lorry"


def test_yaml_is_read_as_version_1_2(tmp_path: Path) -> None:
    # In YAML 1.1 these would be a boolean and 8.
    path = tmp_path / "plain.yaml"
    path.write_text("answer: no\nnumber: 010\n")
    assert load_yaml(path) == {"answer": "no", "number": 10}


def test_lists_of_numbers_stay_on_one_line() -> None:
    text = dump_yaml({"points": [[0.0, 1.5], [2.0, 3.0]], "empty": []})
    assert text == "points:\n- [0.0, 1.5]\n- [2.0, 3.0]\nempty: []\n"
