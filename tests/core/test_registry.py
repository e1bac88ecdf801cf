import pytest

from codediffuser.errors import NotRegisteredError
from codediffuser.registry import Registry


@pytest.fixture
def tasks() -> Registry[object]:
    registry: Registry[object] = Registry("task")
    for name in ("pack_battery", "hang_mug"):
        registry.add(name)(object())
    return registry


def test_an_entry_comes_back_as_it_was(tasks: Registry[object]) -> None:
    entry = object()
    assert tasks.add("stow_book")(entry) is entry
    assert tasks.get("stow_book") is entry


def test_names_are_sorted_whatever_the_order_of_entry(tasks: Registry[object]) -> None:
    assert tasks.names() == list(tasks) == ["hang_mug", "pack_battery"]
    assert len(tasks) == 2
    assert "hang_mug" in tasks and "mug" not in tasks


def test_an_unknown_name_is_answered_with_the_closest_and_all(tasks: Registry[object]) -> None:
    with pytest.raises(NotRegisteredError) as caught:
        tasks.get("pack_batery")
    assert str(caught.value) == (
        "Unknown task 'pack_batery'. Did you mean 'pack_battery'? Known: hang_mug, pack_battery."
    )


def test_a_name_like_no_other_gets_no_guess(tasks: Registry[object]) -> None:
    with pytest.raises(NotRegisteredError, match=r"^Unknown task 'x'\. Known: hang_mug"):
        tasks.get("x")


def test_an_empty_registry_says_so() -> None:
    with pytest.raises(NotRegisteredError, match="Known: none"):
        Registry("policy").get("act")


def test_a_second_entry_under_a_name_is_refused(tasks: Registry[object]) -> None:
    with pytest.raises(ValueError, match="task 'hang_mug' is registered twice"):
        tasks.add("hang_mug")(object())
