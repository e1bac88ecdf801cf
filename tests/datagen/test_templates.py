from collections.abc import Callable
from pathlib import Path

import pytest

from codediffuser.datagen.instructions.generator import check_library
from codediffuser.datagen.instructions.phrasebook import expand_phrases
from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import ConfigError, SchemaVersionError
from codediffuser.schema import dump_yaml

WriteLibrary = Callable[..., Path]


@pytest.fixture
def write_library(tmp_path: Path) -> WriteLibrary:
    """A small template file; the arguments replace its phrases or sentences."""

    def write(
        components: dict[str, list[str]] | None = None,
        templates: dict[str, list[str]] | None = None,
        task: str = "pack_battery",
    ) -> Path:
        sentences = {
            "components": components
            or {"battery": ["left-most battery"], "slot": ["nearest slot"]},
            "templates": templates or {"no_slackness": ["Put the {battery} in the {slot}."]},
        }
        path = tmp_path / "mine.yaml"
        schema = "codediffuser.instruction_templates/1"
        path.write_text(dump_yaml({"schema": schema, "tasks": {task: sentences}}))
        return path

    return write


def test_the_shipped_library_has_the_supplement_counts() -> None:
    counts = {
        "pack_battery": {"no": 5, "battery": 4, "slot": 5, "both": 2},
        "hang_mug": {"no": 8, "mug": 3, "branch": 8, "both": 2},
    }
    for task, expected in counts.items():
        library = load_templates(task)
        found = {k.removesuffix("_slackness"): 0 for k in library.kinds}
        for template in library.templates:
            found[template.kind.removesuffix("_slackness")] += 1
        assert found == expected


def test_stow_book_has_a_library_of_each_kind() -> None:
    library = load_templates("stow_book")
    assert library.kinds == ("no_slackness", "side_slackness", "range_slackness")
    for kind in library.kinds:
        texts = [t.text for t in library.templates if t.kind == kind and t.split == "seen"]
        assert len(set(texts)) == len(texts) >= 12


@pytest.mark.parametrize("task", ["pack_battery", "hang_mug", "stow_book"])
def test_every_kind_has_seen_and_unseen_sentences(task: str) -> None:
    library = load_templates(task)
    for split in ("seen", "unseen"):
        part = library.only(split)  # type: ignore[arg-type]
        assert part.kinds == library.kinds
        assert {t.split for t in part.templates} == {split}
    assert library.only(None) == library


def test_a_library_without_unseen_sentences_says_how_to_mark_some(
    write_library: WriteLibrary,
) -> None:
    library = load_templates("pack_battery", write_library())
    with pytest.raises(ConfigError, match=r"no sentence is unseen; write some as '- unseen"):
        library.only("unseen")


def test_odd_spellings_are_kept() -> None:
    texts = {t.text for t in load_templates("hang_mug").templates}
    assert "Put Bob's mug, the {mug}, on the a branch." in texts
    assert "I will not use this {mug} now. Hang it on {branch}" in texts


def test_every_shipped_phrase_is_known_to_the_task(pack_battery: PackBattery) -> None:
    library = load_templates("pack_battery")
    check_library(pack_battery, library)
    spoken = {words for phrases in library.phrases.values() for words in phrases}
    assert spoken == set(pack_battery.components())


def test_a_template_knows_its_address_and_fills_its_placeholders(
    write_library: WriteLibrary,
) -> None:
    (template,) = load_templates("pack_battery", write_library()).templates
    assert template.id == "pack_battery/no_slackness/0"
    assert template.placeholders == ("battery", "slot")
    filled = template.fill({"battery": "left-most battery", "slot": "nearest slot"})
    assert filled == "Put the left-most battery in the nearest slot."


def test_a_placeholder_that_begins_a_sentence_is_capitalised(write_library: WriteLibrary) -> None:
    text = "{battery} goes there. {slot} is meant, {battery}."
    (template,) = load_templates(
        "pack_battery", write_library(None, {"no_slackness": [text]})
    ).templates
    filled = template.fill({"battery": "the left one", "slot": "the right one"})
    assert filled == "The left one goes there. The right one is meant, the left one."


def test_a_file_may_declare_its_own_kinds(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    kinds = {"far": {"names": ["slot"], "may_name": ["battery"]}}

    def write(text: str, kinds: dict[str, object]) -> None:
        sentences = {
            "components": {"battery": ["*"], "slot": ["*"]}, "kinds": kinds,
            "templates": {"far": ["Into the {slot}.", text]},
        }  # fmt: skip
        schema = "codediffuser.instruction_templates/1"
        path.write_text(dump_yaml({"schema": schema, "tasks": {"pack_battery": sentences}}))
        load_templates.cache_clear()

    write("The {battery} into the {slot}.", dict(kinds))
    assert load_templates("pack_battery", path).kinds == ("far",)
    write("The {battery} into a slot.", dict(kinds))
    with pytest.raises(
        ConfigError, match=r"far\.1'.* names \{slot\}, and may name \{battery\}, got"
    ):
        load_templates("pack_battery", path)
    write("Into the {slot}.", {"far": {"names": ["slots"]}})
    with pytest.raises(ConfigError, match=r"kinds\.far': Unknown category 'slots'\. Did you mean"):
        load_templates("pack_battery", path)


def test_a_star_stands_for_any_words(
    pack_battery: PackBattery, write_library: WriteLibrary
) -> None:
    path = write_library({"battery": ["*-most battery"], "slot": ["nearest slot", "slot on the *"]})
    phrases = expand_phrases(pack_battery, load_templates("pack_battery", path))
    assert len(phrases["battery"]) == 4
    assert "slot on the middle row" in phrases["slot"]
    assert "slot on left column" not in phrases["slot"]
    path = write_library({"battery": ["*-mots battery"], "slot": ["nearest slot"]})
    load_templates.cache_clear()
    with pytest.raises(ConfigError, match=r"components\.battery': Unknown phrase '\*-mots"):
        expand_phrases(pack_battery, load_templates("pack_battery", path))


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("no_slackness", "Put the {batery} in the {slot}.",
         r"Unknown placeholder 'batery'\. Did you mean 'battery'\?"),
        ("battery_slackness", "Put the {battery} in the {slot}.",
         r"a sentence of kind battery_slackness names \{slot\}, got \{battery\}, \{slot\}"),
        ("both_slackness", "Put one in the {slot}.", r"names no placeholder, got \{slot\}"),
        ("no_slackness", "Put the {battery} in a slot.", r"names \{battery\} and \{slot\}"),
        ("no_slackness", "Put the {battery in the {slot}.", r"a brace is not closed|placeholder"),
        ("no_slackness", "Put the {battery} in the slot}.", r"a brace is not closed"),
    ],
)  # fmt: skip
def test_a_wrong_sentence_is_refused_with_file_key_and_placeholder(
    write_library: WriteLibrary, kind: str, text: str, message: str
) -> None:
    path = write_library(templates={kind: [text]})
    with pytest.raises(ConfigError, match=message) as caught:
        load_templates("pack_battery", path)
    assert str(caught.value).startswith(f"{path}: key 'tasks.pack_battery.templates.{kind}.0'")


def test_unknown_kind_and_task_are_refused_with_a_hint(write_library: WriteLibrary) -> None:
    path = write_library(templates={"batery_slackness": ["Put one in the {slot}."]})
    with pytest.raises(ConfigError, match="Did you mean 'battery_slackness'"):
        load_templates("pack_battery", path)
    with pytest.raises(ConfigError, match=r"Unknown task 'pack_batery'\. Did you mean"):
        load_templates("pack_batery")


def test_unknown_phrase_is_refused_with_its_key(
    pack_battery: PackBattery, write_library: WriteLibrary
) -> None:
    path = write_library(components={"battery": ["left most battery"], "slot": ["nearest slot"]})
    with pytest.raises(ConfigError, match="Did you mean 'left-most battery'") as caught:
        check_library(pack_battery, load_templates("pack_battery", path))
    assert "key 'tasks.pack_battery.components.battery'" in str(caught.value)


def test_a_file_needs_two_categories_and_a_sentence(write_library: WriteLibrary) -> None:
    with pytest.raises(ConfigError, match="expected two categories"):
        load_templates("pack_battery", write_library(components={"battery": ["x"]}))
    with pytest.raises(ConfigError, match="at least one sentence"):
        load_templates("pack_battery", write_library(templates={"no_slackness": []}))


def test_parsing_is_strict(tmp_path: Path) -> None:
    path = tmp_path / "templates.yaml"
    path.write_text("schema: codediffuser.instruction_templates/1\ntasks: {}\nextra: 1\n")
    with pytest.raises(ConfigError, match="unknown key 'extra'"):
        load_templates("pack_battery", path)
    path.write_text("tasks: {}\n")
    with pytest.raises(SchemaVersionError, match="the entry 'schema: codediffuser"):
        load_templates("pack_battery", path)
