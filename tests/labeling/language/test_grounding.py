from __future__ import annotations

import json

import numpy as np
import pytest

from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.errors import InstructionError, NotRegisteredError, ProgramError, ShapeError
from codediffuser.labeling.language import ground, simulated_provider
from codediffuser.labeling.language.instances import Instance, ListedInstances


def test_every_sampled_instruction_is_grounded_to_a_pair_it_allows() -> None:
    task = get_task("pack_battery")
    wrong, kinds = [], set()
    for index in range(200):
        scene = sample_scene(task, root_seed=11, index=index)
        grounding = ground(scene.instruction.text, simulated_provider(scene, task=task))
        kinds.add(scene.instruction.kind)
        if (grounding.target("pick"), grounding.target("place")) not in scene.instruction.pairs:
            wrong.append((scene.instruction.text, grounding.targets))
    assert wrong == []
    assert len(kinds) == 4


def test_the_simulator_offers_what_perception_would_see() -> None:
    task = get_task("pack_battery")
    scene = sample_scene(task, root_seed=3, index=1, picks=2, places=4)
    provider = simulated_provider(scene, task=task)
    batteries = provider.instances("battery")
    assert provider.categories == ("battery", "slot", "crate")
    assert len(batteries) == 10
    assert {b.id for b in batteries[:2]} == {o.id for o in scene.pickable}
    assert [s.id for s in provider.instances("slot")] == [p.id for p in scene.free_places]
    for battery in batteries:
        middle = battery.points_world.mean(axis=0)[:2]
        np.testing.assert_allclose(middle, scene.object(battery.id).position_m[:2], atol=1e-5)


def test_given_points_take_the_place_of_the_mesh() -> None:
    scene = sample_scene(get_task("pack_battery"), root_seed=3, index=1)
    name = scene.pickable[0].id
    seen = {name: np.full((5, 3), 0.25), scene.free_places[0].id: np.zeros((0, 3))}
    provider = simulated_provider(scene, seen)
    found = {i.id: i for c in provider.categories for i in provider.instances(c)}
    np.testing.assert_array_equal(found[name].points_world, np.full((5, 3), 0.25, np.float32))
    assert len(found[scene.free_places[0].id].points_world) == 8


def test_a_grounding_tells_how_it_was_found(make_scene) -> None:
    grounding = ground("Put the green battery into a slot.", make_scene(taken=[0]))
    assert [a.kind for a in grounding.attempts if a.text != grounding.instruction] == ["detect"] * 4
    assert ("find_instance_in_category", ("green battery", "battery")) in [
        (c.function, c.arguments) for c in grounding.calls
    ]
    stored = json.loads(json.dumps(grounding.as_json()))
    assert stored["targets"] == {"pick": "b", "place": "slot_1"}
    assert "output_var" in stored["program"] and stored["model"] == "builtin"


def test_the_same_words_give_the_same_answer(make_scene) -> None:
    texts = ["Put a battery into the nearest slot.", "Put the left-most battery in the back row."]
    for text in texts:
        assert ground(text, make_scene()).as_json() == ground(text, make_scene()).as_json()


@pytest.mark.parametrize("text", ["", "   ", "put " * 500])
def test_instructions_have_a_length(text: str, make_scene) -> None:
    with pytest.raises(InstructionError, match="1 to 1000 characters"):
        ground(text, make_scene())


def test_unknown_models_are_refused(make_scene) -> None:
    with pytest.raises(NotRegisteredError, match="language model 'gpt'"):
        ground("Put a battery into a slot.", make_scene(), "gpt")


def test_none_means_that_nothing_fits(make_scene, scripted) -> None:
    model = scripted({"x": "output_var = [None, self.get_obj('slot')[0]]"})
    with pytest.raises(
        InstructionError, match="looked for the battery that it asks for; there are"
    ):
        ground("x", make_scene(), model)


def test_a_failing_program_says_what_was_not_there(make_scene, scripted) -> None:
    nothing = "output_var = []"
    model = scripted({"x": "output_var = [self.detect('red battery')[0]]", "red battery": nothing})
    with pytest.raises(ProgramError, match=r'nothing was found for "red battery"'):
        ground("x", make_scene(), model)


def test_programs_may_ask_for_a_limited_number_of_phrases(make_scene, scripted) -> None:
    many = (
        "output_var = ["
        + "self.detect('a'), " * 3
        + ", ".join(f"self.detect('p{i}')" for i in range(40))
        + "]"
    )
    replies = {f"p{i}": "output_var = []" for i in range(40)}
    with pytest.raises(ProgramError, match="at most 32 phrases"):
        ground("x", make_scene(), scripted({"x": many, "a": "output_var = []", **replies}))


def test_detection_programs_cannot_detect(make_scene, scripted) -> None:
    loop = {"x": "output_var = self.detect('y')", "y": "output_var = self.detect('y')"}
    with pytest.raises(ProgramError, match=r"detect 'y'.*`self.detect` is not offered"):
        ground("x", make_scene(), scripted(loop))


def test_unknown_categories_are_named_with_the_closest(make_scene, scripted) -> None:
    model = scripted({"x": "output_var = self.get_obj('batery')"})
    with pytest.raises(ProgramError, match="Did you mean 'battery'"):
        ground("x", make_scene(), model)


def test_instances_need_points_and_ids_of_their_own(box) -> None:
    with pytest.raises(ShapeError, match=r"N >= 1, got \(0, 3\)"):
        Instance("a", "battery", "battery", np.zeros((0, 3)))
    one = Instance("a", "battery", "battery", box((0, 0, 0)))
    with pytest.raises(ValueError, match="used twice"):
        ListedInstances([one, one], {"pick": "battery", "place": "slot"})
