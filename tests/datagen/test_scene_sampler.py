import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.instructions.templates import load_templates
from codediffuser.datagen.reset_image import render_png
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene, sample_scenes
from codediffuser.datagen.task import get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import (
    ConfigError,
    InstructionError,
    NotRegisteredError,
    PlacementError,
)
from codediffuser.schema import dump_yaml
from codediffuser.seeding import Stage


def folder_bytes(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


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
    assert scene.seed.model_dump() == {"root": 3, "stage": "EVAL_SCENE", "index": 42, "attempt": 0}
    scene.save(tmp_path / "scene.yaml")
    assert SceneSpec.load(tmp_path / "scene.yaml") == scene


def test_workers_and_order_change_no_byte(pack_battery: PackBattery, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    paths = list(sample_scenes(pack_battery, one, 6, 11))
    assert paths == [one / f"{i:06d}.yaml" for i in range(6)]
    sample_some = sample_scene(pack_battery, root_seed=11, index=4)  # Out of order, in no folder.
    list(sample_scenes(pack_battery, two, 6, 11, workers=2))
    assert folder_bytes(one) == folder_bytes(two)
    assert len(folder_bytes(one)) == 12
    assert SceneSpec.load(one / "000004.yaml") == sample_some


def test_running_again_draws_only_what_is_missing(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    list(sample_scenes(pack_battery, tmp_path, 3, 11))
    whole = folder_bytes(tmp_path)
    (tmp_path / "000001.png").unlink()
    (tmp_path / "000002.yaml").unlink()
    (tmp_path / ".partial-999999999-000002.yaml").write_text("killed here")
    kept = os.stat(tmp_path / "000000.png").st_mtime_ns
    list(sample_scenes(pack_battery, tmp_path, 3, 11))
    assert folder_bytes(tmp_path) == whole
    assert os.stat(tmp_path / "000000.png").st_mtime_ns == kept


def test_scenes_of_another_seed_are_not_mixed_in_unless_overwritten(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    list(sample_scenes(pack_battery, tmp_path, 1, 11))
    with pytest.raises(
        ConfigError, match=r"holds a scene with seed 11, expected 12; .*--overwrite"
    ):
        list(sample_scenes(pack_battery, tmp_path, 1, 12))
    list(sample_scenes(pack_battery, tmp_path, 1, 12, overwrite=True))
    scene = SceneSpec.load(tmp_path / "000000.yaml")
    assert scene.seed.root == 12
    picture = (tmp_path / "000000.png").read_bytes()
    assert picture == render_png(pack_battery.draw_reset(scene))


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
    drawn = [sample_scene(pack_battery, root_seed=0, index=i, library=library) for i in range(5)]
    assert any(scene.seed.attempt > 0 for scene in drawn)
    assert all(len(scene.instruction.pairs) == 1 for scene in drawn)


def test_redraws_are_bounded(pack_battery: PackBattery, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "schema: codediffuser.instruction_templates/1\ntasks:\n  pack_battery:\n"
        "    components: {battery: [left-most battery], slot: [nearest slot]}\n"
        "    templates: {slot_slackness: ['I need the {other_battery}, not the {battery}.']}\n"
    )
    library = load_templates("pack_battery", path)
    with pytest.raises(InstructionError, match=r"scene 000000: no instruction in 50 layouts; last"):
        sample_scene(pack_battery, root_seed=0, index=0, library=library)


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
