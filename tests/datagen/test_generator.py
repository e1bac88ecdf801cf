from collections.abc import Callable

import numpy as np
import pytest

from codediffuser.datagen.instructions.generator import check_instruction, make_instruction
from codediffuser.datagen.instructions.phrasebook import Sentence
from codediffuser.datagen.instructions.reading import Reading, allowed_pairs
from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.datagen.layout import Layout
from codediffuser.datagen.scene import Pair, SceneSpec, Target
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import InstructionError

Make = Callable[..., Layout]

ROWS = {"back-most row": {0, 1, 2, 3}, "middle row": {4, 5, 6, 7}, "front-most row": {8, 9, 10, 11}}
COLUMNS = {
    "left column": {3, 7, 11},
    "middle columns": {1, 2, 5, 6, 9, 10},
    "right column": {0, 4, 8},
}


def oracle_pairs(scene: SceneSpec) -> set[Pair]:
    """What the sentence allows, from the sentence alone: what is said last is what is meant."""
    text = scene.instruction.text
    waiting = {o.id: o.position_m for o in scene.objects if o.category == "battery" and not o.place}
    taken = {o.place for o in scene.objects}
    free = {p.id: p.position_m for p in scene.places if p.id not in taken}
    keys = {"left-most": (0, -1), "right-most": (0, 1), "front-most": (1, -1), "back-most": (1, 1)}
    said = {text.rfind(f"{w} battery"): w for w in keys}
    picks = set(waiting)
    if (last := max(said)) >= 0:
        axis, sign = keys[said[last]]
        picks = {max(waiting, key=lambda i: sign * waiting[i][axis])}
    places = {**ROWS, **COLUMNS, "nearest slot": set(), "furthest slot": set()}
    last, words = max((text.rfind(w), w) for w in places)
    pairs = set()
    for battery in picks:
        chosen = {f"slot_{i:02d}" for i in places[words]} & set(free) if last >= 0 else set(free)
        if last >= 0 and words.endswith("slot"):
            distance = {
                i: float(np.linalg.norm(np.subtract(free[i], waiting[battery]))) for i in free
            }
            extreme = min if words == "nearest slot" else max
            chosen = {extreme(distance, key=distance.__getitem__)}
        pairs |= {(battery, slot) for slot in chosen}
    return pairs


def test_pairs_of_300_scenes_are_those_of_the_oracle(scenes: list[SceneSpec]) -> None:
    for scene in scenes:
        assert set(scene.instruction.pairs) == oracle_pairs(scene), scene.instruction.text
        assert list(scene.instruction.pairs) == sorted(scene.instruction.pairs)
        assert (scene.target.pick, scene.target.place) in scene.instruction.pairs


def test_every_kind_and_every_template_occurs_and_kinds_come_evenly(
    scenes: list[SceneSpec],
) -> None:
    drawn = [scene.instruction.template_id for scene in scenes]
    assert set(drawn) == {t.id for t in load_templates("pack_battery").templates}
    kinds = [scene.instruction.kind for scene in scenes]
    assert all(0.15 < kinds.count(kind) / len(kinds) < 0.35 for kind in set(kinds))


def test_every_phrase_occurs(scenes: list[SceneSpec], pack_battery: PackBattery) -> None:
    spoken = {words for s in scenes for words in s.instruction.components.values()}
    assert spoken == set(pack_battery.components())


def test_what_is_other_is_there_and_never_meant(
    scenes: list[SceneSpec], pack_battery: PackBattery
) -> None:
    seen = 0
    for scene in scenes:
        words = scene.instruction.components
        for category in ("battery", "slot"):
            if f"other_{category}" not in words:
                continue
            seen += 1
            instead = {**words, category: words[f"other_{category}"]}
            del instead[f"other_{category}"]
            others = allowed_pairs(pack_battery, scene, instead)
            assert others
            assert not set(others) & set(scene.instruction.pairs)
            if category == "battery":
                assert scene.ambiguity.picks >= 2
    assert seen > 30


def test_a_margin_separates_what_extremes_name(scenes: list[SceneSpec]) -> None:
    axes = {"left-most": (0, -1), "right-most": (0, 1), "front-most": (1, -1), "back-most": (1, 1)}
    for scene in scenes:
        words = scene.instruction.components.get("battery")
        if words is None or len(scene.pickable) < 2:
            continue
        axis, sign = axes[words.split()[0]]
        along = sorted(sign * o.position_m[axis] for o in scene.pickable)
        assert along[-1] - along[-2] >= 0.010


def test_naming_only_the_other_battery_means_all_the_rest(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    scene = make_layout([(-0.08, 0.0), (0.0, 0.0), (0.06, 0.0)], free=[1])
    pairs = allowed_pairs(pack_battery, scene, {"other_battery": "left-most battery"})
    assert pairs == (("battery_1", "slot_01"), ("battery_2", "slot_01"))


def test_a_phrase_unclear_for_one_of_the_meant_batteries_is_refused(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    # battery_0 stands on the crate's line of symmetry: no slot is clearly nearest to it.
    scene = make_layout([(-0.01, 0.0), (0.06, -0.08)])
    with pytest.raises(InstructionError, match=r"'nearest slot' for battery_0 fits nothing"):
        allowed_pairs(pack_battery, scene, {"slot": "nearest slot"})
    named = {"battery": "right-most battery", "slot": "nearest slot"}
    assert allowed_pairs(pack_battery, scene, named) == (("battery_1", "slot_08"),)


def test_other_slots_that_overlap_are_refused(pack_battery: PackBattery, make_layout: Make) -> None:
    scene = make_layout([(0.0, 0.0)])
    words = {"slot": "slot on the middle row", "other_slot": "slot on the right column"}
    with pytest.raises(InstructionError, match="means slot_04 too"):
        allowed_pairs(pack_battery, scene, words)


def test_unknown_words_are_refused_with_a_hint(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    with pytest.raises(InstructionError, match="Did you mean 'left-most battery'"):
        allowed_pairs(pack_battery, make_layout([(0, 0)]), {"battery": "left-mots battery"})


def test_a_sentence_is_said_of_a_scene_or_refused(
    pack_battery: PackBattery, make_layout: Make
) -> None:
    library = load_templates("pack_battery")
    template = next(t for t in library.templates if t.id == "pack_battery/slot_slackness/0")
    sentence = Sentence(template, {"battery": "left-most battery"})
    scene = make_layout([(-0.08, 0.0), (0.06, 0.0)])
    said = make_instruction(Reading(pack_battery, scene), sentence)
    assert said.text == "Pick the left-most battery outside the crate into a slot."
    assert said.pairs == tuple(("battery_0", f"slot_{i:02d}") for i in range(12))
    assert (said.template_id, said.template_split) == (template.id, "seen")
    tied = make_layout([(-0.05, 0.0), (-0.05, -0.09)])
    with pytest.raises(InstructionError, match="'left-most battery' fits nothing in the scene"):
        make_instruction(Reading(pack_battery, tied), sentence)


def changed(scene: SceneSpec, **update: object) -> SceneSpec:
    said = scene.instruction.model_copy(update=update)
    return scene.model_copy(update={"instruction": said})


def test_check_instruction_finds_every_kind_of_lie(scenes: list[SceneSpec]) -> None:
    scene = next(
        s for s in scenes if s.instruction.kind == "battery_slackness" and s.ambiguity.picks > 2
    )
    check_instruction(scene)
    with pytest.raises(InstructionError, match="the scene stores"):
        check_instruction(changed(scene, pairs=scene.instruction.pairs[:-1]))
    with pytest.raises(InstructionError, match="is not in the sentence"):
        check_instruction(changed(scene, text="Put it away."))
    wrong_target = Target(
        pick=scene.target.pick,
        place=next(p.id for p in scene.places if p.id not in dict(scene.instruction.pairs).values()
                   and (scene.target.pick, p.id) not in scene.instruction.pairs),
    )  # fmt: skip
    with pytest.raises(InstructionError, match="does not allow the target"):
        check_instruction(scene.model_copy(update={"target": wrong_target}))
