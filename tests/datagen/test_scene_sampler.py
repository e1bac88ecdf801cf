import itertools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.configuration_split import configuration_split
from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.datagen.sampling_settings import SamplingSettings, parse_factors
from codediffuser.datagen.scene import SceneSpec, SeedKey, TemplateSplit
from codediffuser.datagen.scene_sampler import SceneSource, sample_scene
from codediffuser.datagen.task import TASKS, get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import (
    ConfigError,
    InstructionError,
    NotRegisteredError,
    PlacementError,
)
from codediffuser.schema import dump_yaml
from codediffuser.seeding import Stage


def changed_task(variant: dict[str, object]) -> PackBattery:
    """The task with some of its ranges changed."""
    config = PackBattery.load_config()
    ranges = config.variants["sim"].model_copy(update=variant)
    return PackBattery(config.model_copy(update={"variants": {"sim": ranges}}))


def test_same_address_gives_the_same_scene(pack_battery: PackBattery) -> None:
    for index in (0, 5):
        first, again = (sample_scene(pack_battery, root_seed=3, index=index) for _ in range(2))
        assert first == again


def test_seed_index_and_stage_each_change_the_scene(pack_battery: PackBattery) -> None:
    drawn = [
        sample_scene(pack_battery, root_seed=0, index=0),
        sample_scene(pack_battery, root_seed=1, index=0),
        sample_scene(pack_battery, root_seed=0, index=1),
        sample_scene(pack_battery, root_seed=0, index=0, stage=Stage.EVAL_SCENE),
    ]
    positions = {scene.objects[0].position_m for scene in drawn}
    assert len(positions) == len(drawn)


def test_a_scene_records_its_address_and_survives_its_file(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    scene = sample_scene(pack_battery, root_seed=3, index=42, stage=Stage.EVAL_SCENE, split="eval")
    assert scene.scene_id == "000042"
    attempt = scene.seed.attempt
    assert scene.seed == SeedKey(root=3, stage="EVAL_SCENE", index=42, attempt=attempt)
    scene.save(tmp_path / "scene.yaml")
    assert SceneSpec.load(tmp_path / "scene.yaml") == scene


def test_ambiguity_counts_what_can_be_picked_and_placed(scenes: list[SceneSpec]) -> None:
    for scene in scenes:
        waiting = [o for o in scene.objects if o.category == "battery" and o.place is None]
        taken = {o.place for o in scene.objects if o.place}
        assert scene.ambiguity.picks == len(waiting)
        assert scene.ambiguity.places == 12 - len(taken)
    assert Counter(s.ambiguity.picks for s in scenes).keys() == {1, 2, 3, 4}
    assert Counter(s.ambiguity.places for s in scenes).keys() == set(range(1, 13))


def test_targets_are_drawn_evenly(scenes: list[SceneSpec]) -> None:
    rank = [
        [o.id for o in s.pickable].index(s.target.pick) for s in scenes if s.ambiguity.picks == 2
    ]
    assert 0.3 < np.mean(rank) < 0.7
    assert len({s.target.place for s in scenes}) == 12


@pytest.mark.parametrize(("picks", "places"), [(1, 12), (4, 1), (2, 7)])
def test_ambiguity_can_be_asked_for(pack_battery: PackBattery, picks: int, places: int) -> None:
    scene = sample_scene(pack_battery, root_seed=0, index=0, picks=picks, places=places)
    assert (scene.ambiguity.picks, scene.ambiguity.places) == (picks, places)


def test_ambiguity_out_of_range_and_unknown_variant_are_refused(pack_battery: PackBattery) -> None:
    with pytest.raises(ConfigError, match="picks: waiting batteries: expected 1 to 4, got 9"):
        sample_scene(pack_battery, root_seed=0, index=0, picks=9)
    with pytest.raises(ConfigError, match="places: free slots: expected 1 to 12, got 0"):
        sample_scene(pack_battery, root_seed=0, index=0, places=0)
    with pytest.raises(ConfigError, match=r"Unknown variant 'sin'\. Did you mean 'sim'\?"):
        sample_scene(pack_battery, root_seed=0, index=0, variant="sin")


def test_a_scene_that_cannot_be_placed_names_task_scene_and_remedy() -> None:
    task = changed_task({"min_distance_m": 0.5, "max_redraws": 3})
    with pytest.raises(PlacementError) as caught:
        sample_scene(task, root_seed=0, index=3, picks=2)
    assert str(caught.value).startswith("pack_battery, scene 000003: cannot place 2 waiting")
    assert "lower 'variants.sim.min_distance_m' to " in str(caught.value)


def test_an_area_over_the_crate_is_told_to_move() -> None:
    task = changed_task({"area_y_m": (0.15, 0.20), "max_redraws": 3})
    with pytest.raises(PlacementError, match=r"of the crate; move 'variants\.sim\.area_x_m'"):
        sample_scene(task, root_seed=0, index=0)


def test_a_scene_is_drawn_again_until_a_sentence_fits(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "schema: codediffuser.instruction_templates/1\ntasks:\n  pack_battery:\n"
        "    components: {battery: [left-most battery], slot: [nearest slot]}\n"
        "    templates: {no_slackness: ['Put the {battery} in the {slot}.']}\n"
    )
    library = load_templates("pack_battery", path)
    drawn = [sample_scene(pack_battery, root_seed=0, index=i, library=library) for i in range(12)]
    assert any(scene.seed.attempt > 0 for scene in drawn)
    assert all(len(scene.instruction.pairs) == 1 for scene in drawn)


def test_redraws_are_bounded_and_the_error_names_remedies(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "schema: codediffuser.instruction_templates/1\ntasks:\n  pack_battery:\n"
        "    components: {battery: [left-most battery], slot: [nearest slot]}\n"
        "    templates: {slot_slackness: ['I need the {other_battery}, not the {battery}.']}\n"
    )
    library = load_templates("pack_battery", path)
    with pytest.raises(InstructionError) as caught:
        sample_scene(pack_battery, root_seed=0, index=0, library=library, picks=2, split="train")
    message = str(caught.value)
    assert message.startswith("pack_battery, scene 000000: none of 400 layouts fits its sentence")
    assert "is the other battery, yet 'left-most battery' means" in message
    assert "widen split train by the key 'splits' of pack_battery.yaml" in message
    assert "ask for more picks or places" in message
    assert f"change the sentence in {path}" in message


def test_sentences_about_another_object_are_not_tried_with_one(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    for index in range(20):
        scene = sample_scene(pack_battery, root_seed=0, index=index, picks=1, places=1)
        assert not any(p.startswith("other_") for p in scene.instruction.components)
    path = tmp_path / "mine.yaml"
    path.write_text(
        "schema: codediffuser.instruction_templates/1\ntasks:\n  pack_battery:\n"
        "    components: {battery: [left-most battery], slot: [nearest slot]}\n"
        "    templates: {slot_slackness: ['I need the {other_battery}, not the {battery}.']}\n"
    )
    with pytest.raises(ConfigError, match=r"every sentence mentions an 'other' .* picks 1 .* more"):
        sample_scene(
            pack_battery,
            root_seed=0,
            index=0,
            picks=1,
            library=load_templates("pack_battery", path),
        )


def test_splits_share_no_configuration(pack_battery: PackBattery) -> None:
    splits = pack_battery.config.splits
    for split in ("train", "val", "held_out"):
        source = SceneSource(pack_battery, SamplingSettings(root_seed=5, split=split))
        for index in range(25):
            scene = source.draw(index)
            x, y, _ = scene.object(scene.target.pick).position_m
            assert scene.split == split
            assert configuration_split(splits, (x, y), scene.target.place) == split
            assert (scene.target.place in splits.held_out_places) == (split == "held_out")


def test_a_task_that_holds_nothing_out_says_where_to_say_so() -> None:
    config = PackBattery.load_config()
    nothing = config.splits.model_copy(update={"held_out_places": ()})
    task = PackBattery(config.model_copy(update={"splits": nothing}))
    with pytest.raises(InstructionError, match="split held_out by the key 'splits' of pack_bat"):
        sample_scene(task, root_seed=0, index=0, split="held_out")


@pytest.mark.parametrize("split", ["seen", "unseen"])
def test_sentences_can_be_kept_to_one_split(
    pack_battery: PackBattery, split: TemplateSplit
) -> None:
    library = load_templates("pack_battery")
    allowed = {t.id for t in library.templates if t.split == split}
    for index in range(20):
        said = sample_scene(
            pack_battery, root_seed=0, index=index, template_split=split
        ).instruction
        assert said.template_split == split
        assert said.template_id in allowed


def test_strata_are_spread_evenly_and_only_possible_ones_asked_for(
    pack_battery: PackBattery,
) -> None:
    factors = ("kind", "picks")
    settings = SamplingSettings(root_seed=2, stratify=factors)
    source = SceneSource(pack_battery, settings)
    block = [source.draw(i) for i in range(16)]
    seen = Counter((s.instruction.kind, s.ambiguity.picks) for s in block)
    assert len(seen) == 16
    assert set(seen.values()) == {1}
    assert source.draw(3) == sample_scene(pack_battery, root_seed=2, index=3, stratify=factors)


def test_target_places_can_be_spread_evenly_within_a_split(pack_battery: PackBattery) -> None:
    settings = SamplingSettings(root_seed=2, stratify=("target_place",), split="train")
    source = SceneSource(pack_battery, settings)
    left = 12 - len(pack_battery.config.splits.held_out_places)
    assert len({source.draw(i).target.place for i in range(left)}) == left


@pytest.mark.parametrize("task_name", sorted(TASKS))
def test_starts_can_be_spread_evenly_over_the_quarters_of_the_table(task_name: str) -> None:
    task = get_task(task_name)
    settings = SamplingSettings(root_seed=2, stratify=("start",), split="train")
    source = SceneSource(task, settings)
    scenes = [source.draw(i) for i in range(16)]
    starts = np.array([s.object(s.target.pick).position_m[:2] for s in scenes])
    xs, ys = (np.sort(column) for column in starts.T)
    cut_x, cut_y = (xs[7] + xs[8]) / 2, (ys[7] + ys[8]) / 2
    quarters = Counter((bool(x > cut_x), bool(y > cut_y)) for x, y in starts)
    assert quarters == dict.fromkeys(itertools.product((False, True), repeat=2), 4)


def test_unknown_factors_are_refused_with_a_hint() -> None:
    assert parse_factors(("picks", "kind")) == ("kind", "picks")
    with pytest.raises(ConfigError, match=r"Unknown factor 'kinds'\. Did you mean 'kind'"):
        parse_factors(("kinds",))
    with pytest.raises(ConfigError, match="each factor once"):
        parse_factors(("kind", "kind"))


def test_an_unknown_task_gets_a_hint() -> None:
    with pytest.raises(NotRegisteredError, match="Did you mean 'pack_battery'"):
        get_task("pack_batery")


def test_an_unknown_key_in_the_task_yaml_is_refused_with_a_hint(tmp_path: Path) -> None:
    raw = PackBattery.load_config().model_dump(mode="json", by_alias=True)
    raw["variants"]["sim"]["min_distanc_m"] = 0.1
    path = tmp_path / "task.yaml"
    path.write_text(dump_yaml(raw))
    with pytest.raises(
        ConfigError, match=r"task\.yaml: unknown key 'variants\.sim\.min_distanc_m'"
    ):
        PackBattery.load_config(path)


def test_counts_that_leave_no_free_slot_are_refused(tmp_path: Path) -> None:
    raw = PackBattery.load_config().model_dump(mode="json", by_alias=True)
    raw["variants"]["sim"]["packed_count"] = [0, 12]
    path = tmp_path / "task.yaml"
    path.write_text(dump_yaml(raw))
    with pytest.raises(ConfigError, match=r"variants\.sim\.packed_count: expected .* < 12"):
        PackBattery.load_config(path)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_ranges_that_end_before_they_begin_are_refused(tmp_path: Path, axis: str) -> None:
    raw = PackBattery.load_config().model_dump(mode="json", by_alias=True)
    raw["variants"]["real"][f"area_{axis}_m"] = [0.1, -0.1]
    path = tmp_path / "task.yaml"
    path.write_text(dump_yaml(raw))
    with pytest.raises(ConfigError, match=rf"real\.area_{axis}_m'.* with low <= high"):
        PackBattery.load_config(path)


def test_the_real_variant_has_one_to_three_batteries_on_a_larger_pad(
    pack_battery: PackBattery,
) -> None:
    source = SceneSource(pack_battery, SamplingSettings(root_seed=0, variant="real"))
    drawn = [source.draw(i) for i in range(40)]
    assert {s.ambiguity.picks for s in drawn} == {1, 2, 3}
    assert {s.variant for s in drawn} == {"real"}
    assert any(o.place for s in drawn for o in s.objects)
    (pad,) = pack_battery.pads("real")
    assert pad.name == "orange pad"
    (smaller,) = pack_battery.pads("sim")
    assert pad.low_m < smaller.low_m and pad.high_m > smaller.high_m
    for scene in drawn:
        for battery in scene.pickable:
            x, y, _ = battery.position_m
            assert pad.low_m[0] < x < pad.high_m[0] and pad.low_m[1] < y < pad.high_m[1]
