"""Laws of selecting: what undo, redo, toggling and boxes do to any draft."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from codediffuser.labeling.gui.draft import (
    Draft,
    RoleNeed,
    complete,
    missing,
    next_role,
    select_box,
    toggle,
)
from codediffuser.labeling.instances import SelectableInstance
from codediffuser.labeling.label import Role

NEEDS = (RoleNeed("pick", "battery"), RoleNeed("place", "slot"))


def thing(name: str, role: Role | None) -> SelectableInstance:
    return SelectableInstance(name, "x", name, role, np.zeros((1, 3), np.float32))


BATTERIES = [thing(f"battery_{i}", "pick") for i in range(3)]
SLOTS = [thing(f"slot_{i}", "place") for i in range(3)]
CLUSTERS = [thing(f"cluster_{i}", None) for i in range(3)]
THINGS = BATTERIES + SLOTS + CLUSTERS

actions = st.one_of(
    st.sampled_from([("undo",), ("redo",), ("clear",)]),
    st.tuples(st.just("toggle"), st.sampled_from(THINGS)),
    st.tuples(st.just("box"), st.lists(st.sampled_from(THINGS), unique_by=id, max_size=4)),
)


def act(draft: Draft, action: tuple) -> Draft:
    match action:
        case ("undo",):
            return draft.undo()
        case ("redo",):
            return draft.redo()
        case ("clear",):
            return draft.with_selection(())
        case ("toggle", instance):
            return toggle(draft, instance, NEEDS)
        case ("box", instances):
            return select_box(draft, instances, NEEDS)
    raise AssertionError(action)


def played(steps: list[tuple]) -> Draft:
    draft = Draft()
    for step in steps:
        draft = act(draft, step)
    return draft


drafts = st.lists(actions, max_size=12).map(played)


@given(drafts, st.sampled_from(THINGS))
def test_undo_takes_back_any_change(draft: Draft, instance: SelectableInstance) -> None:
    changed = toggle(draft, instance, NEEDS)
    assert changed.undo().selection == draft.selection
    assert changed.undo().redo().selection == changed.selection


@given(drafts)
def test_undoing_everything_leads_to_nothing_and_redoing_everything_back(draft: Draft) -> None:
    back = draft
    for _ in draft.past:
        back = back.undo()
    assert back.selection == () and not back.past and back.undo() == back
    for _ in draft.past:
        back = back.redo()
    assert back == draft


@given(drafts, st.sampled_from(THINGS))
def test_a_second_click_deselects(draft: Draft, instance: SelectableInstance) -> None:
    selected = draft if draft.role_of(instance.id) else toggle(draft, instance, NEEDS)
    assert selected.role_of(instance.id) is not None
    assert toggle(selected, instance, NEEDS).role_of(instance.id) is None


@given(drafts)
def test_nothing_is_selected_twice(draft: Draft) -> None:
    names = [name for _, name in draft.selection]
    assert len(names) == len(set(names))


@given(drafts, st.sampled_from(BATTERIES + SLOTS))
def test_an_instance_is_selected_for_its_own_role_alone(
    draft: Draft, instance: SelectableInstance
) -> None:
    assert toggle(draft, instance, NEEDS).role_of(instance.id) in (instance.role, None)


@given(st.lists(st.tuples(st.just("toggle"), st.sampled_from(THINGS)), max_size=12))
def test_clicks_alone_never_overfill_a_role(steps: list[tuple]) -> None:
    assert all(count >= 0 for count in missing(played(steps), NEEDS).values())


@given(drafts)
def test_a_new_change_forgets_what_was_undone(draft: Draft) -> None:
    undone = draft.undo()
    changed = undone.with_selection((("pick", "something new"),))
    assert changed.redo() == changed


def test_a_click_in_a_full_role_replaces_the_older_target() -> None:
    draft = toggle(toggle(Draft(), BATTERIES[0], NEEDS), BATTERIES[1], NEEDS)
    assert draft.chosen("pick") == ("battery_1",)
    assert draft.undo().chosen("pick") == ("battery_0",)


def test_instances_without_a_role_fill_the_roles_in_order() -> None:
    draft = Draft()
    assert next_role(draft, NEEDS) == "pick"
    draft = toggle(draft, CLUSTERS[2], NEEDS)
    assert draft.selection == (("pick", "cluster_2"),) and next_role(draft, NEEDS) == "place"
    draft = toggle(draft, CLUSTERS[0], NEEDS)
    assert complete(draft, NEEDS) and next_role(draft, NEEDS) is None


def test_a_box_takes_several_and_says_how_many_are_too_many() -> None:
    draft = select_box(Draft(), [*BATTERIES, SLOTS[1]], NEEDS)
    assert missing(draft, NEEDS) == {"pick": -2, "place": 0} and not complete(draft, NEEDS)
    for battery in BATTERIES[:2]:
        draft = toggle(draft, battery, NEEDS)
    assert complete(draft, NEEDS) and draft.chosen("pick") == ("battery_2",)


def test_a_box_over_one_role_keeps_the_other() -> None:
    draft = toggle(Draft(), BATTERIES[0], NEEDS)
    assert select_box(draft, [SLOTS[0]], NEEDS).selection == (
        ("pick", "battery_0"),
        ("place", "slot_0"),
    )


def test_a_role_may_take_several() -> None:
    needs = (RoleNeed("pick", "battery", 2), NEEDS[1])
    draft = toggle(toggle(Draft(), BATTERIES[0], needs), BATTERIES[1], needs)
    assert draft.chosen("pick") == ("battery_0", "battery_1")
    assert toggle(draft, BATTERIES[2], needs).chosen("pick") == ("battery_1", "battery_2")
