from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen.check_scenes import check_scene, check_scenes, describe, main
from codediffuser.datagen.overlap import OverlapChecker
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_oracle import meaning
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import TASKS, Task, get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import ConfigError

Damage = Callable[[SceneSpec], SceneSpec]


def moved(scene: SceneSpec, object_id: str, position_m: tuple[float, float, float]) -> SceneSpec:
    """The scene with one object somewhere else."""
    objects = tuple(
        o.model_copy(update={"position_m": position_m}) if o.id == object_id else o
        for o in scene.objects
    )
    return scene.model_copy(update={"objects": objects})


def said(scene: SceneSpec, **update: object) -> SceneSpec:
    words = scene.instruction.model_copy(update=update)
    return scene.model_copy(update={"instruction": words})


@pytest.fixture(params=TASKS.names())
def task(request: pytest.FixtureRequest) -> Task:
    return get_task(request.param)


def test_the_oracle_agrees_with_the_phrases_of_every_task(task: Task) -> None:
    for index in range(12):
        for variant in ("sim", "real"):
            scene = sample_scene(task, root_seed=8, index=index, variant=variant)
            found = meaning(scene, task.config.observer, task.pick_category)
            assert found.unknown_words == found.empty_words == ()
            assert found.pairs == set(scene.instruction.pairs), scene.instruction.text
            assert found.smallest_lead_m >= 0.004


def two_waiting(task: PackBattery) -> SceneSpec:
    return sample_scene(task, root_seed=0, index=0, picks=2, places=6)


def test_batteries_that_run_into_each_other_are_found(pack_battery: PackBattery) -> None:
    scene, checker = two_waiting(pack_battery), OverlapChecker(pack_battery)
    x, y, z = scene.object("battery_0").position_m
    assert list(checker.overlaps(scene)) == []
    into = moved(scene, "battery_1", (x + 0.029, y, z))  # Twice the radius is 0.030.
    assert list(checker.overlaps(into)) == [("battery_0", "battery_1")]
    beside = moved(scene, "battery_1", (x + 0.0305, y, z))
    assert list(checker.overlaps(beside)) == []


def test_a_battery_in_a_wall_or_in_the_table_is_found(pack_battery: PackBattery) -> None:
    scene, checker = two_waiting(pack_battery), OverlapChecker(pack_battery)
    x, y, z = pack_battery.config.crate.position_m
    in_wall = moved(scene, "battery_0", (x, y, z + 0.02))  # The wall between columns 1 and 2.
    assert ("battery_0", "crate") in list(checker.overlaps(in_wall))
    sunk = moved(scene, "battery_0", (0.0, 0.0, -0.001))
    assert checker.below_table(sunk) == ["battery_0"]


DAMAGES: dict[str, Damage] = {
    "unsatisfied instructions": lambda s: said(s, pairs=s.instruction.pairs[1:]),
    "sentences that differ from their template": lambda s: said(s, text=s.instruction.text + "!"),
    "scenes outside of their split": lambda s: s.model_copy(update={"split": "held_out"}),
}


@pytest.mark.parametrize("heading", DAMAGES)
def test_every_lie_is_found_under_its_heading(
    pack_battery: PackBattery, tmp_path: Path, heading: str
) -> None:
    scenes = (
        sample_scene(pack_battery, root_seed=0, index=i, picks=2, split="train") for i in range(40)
    )
    scene = next(s for s in scenes if s.instruction.kind == "slot_slackness")
    path = tmp_path / "000000.yaml"
    scene.save(path)
    assert check_scene(path).findings == []
    DAMAGES[heading](scene).save(path)
    assert heading in {found for found, _ in check_scene(path).findings}


def test_a_near_tie_is_no_unique_phrase(pack_battery: PackBattery, tmp_path: Path) -> None:
    scenes = (sample_scene(pack_battery, root_seed=0, index=i, picks=2) for i in range(80))
    scene = next(
        s for s in scenes if s.instruction.components.get("battery") == "left-most battery"
    )
    first, second = scene.pickable
    other = second if scene.target.pick == first.id else first
    x, _, z = scene.object(scene.target.pick).position_m
    tied = moved(scene, other.id, (x + 0.003, other.position_m[1], z))
    path = tmp_path / "000000.yaml"
    tied.save(path)
    assert "non-unique phrases" in {heading for heading, _ in check_scene(path).findings}


def test_the_command_counts_and_tells_by_its_exit_code(
    pack_battery: PackBattery, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for index in range(3):
        sample_scene(pack_battery, root_seed=0, index=index).save(tmp_path / f"00000{index}.yaml")
    assert main([str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("3 scenes read and checked, ")
    assert "overlaps: 0" in text
    assert "templates and phrases unused" in text
    (tmp_path / "000001.yaml").write_text("schema: codediffuser.scene/2\n")
    assert main([str(tmp_path)]) == 3
    assert "unreadable: 1" in capsys.readouterr().out
    assert "unreadable: 1" in describe(check_scenes([tmp_path]))


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no scene in it; sample some"):
        check_scenes([tmp_path])


def test_phrases_that_are_never_said_are_those_that_fit_no_layout() -> None:
    task = get_task("stow_book")
    never, rng = task.never_said(), np.random.default_rng(0)
    unseen = {words: phrase for words, phrase in task.components().items() if words not in never}
    layouts = 0
    while unseen and layouts < 300:
        layout = task.sample_layout(rng, variant=("sim", "real")[layouts % 2])
        unseen = {words: phrase for words, phrase in unseen.items() if not phrase.check(layout)}
        said = [words for words in never if task.components()[words].check(layout)]
        assert said == []
        layouts += 1
    assert unseen == {}
    assert "between TIGER and the orange book" in never and len(never) == 60


def test_coverage_counts_what_can_be_said(tmp_path: Path) -> None:
    task = get_task("stow_book")
    sample_scene(task, root_seed=0, index=0).save(tmp_path / "000000.yaml")
    text = describe(check_scenes([tmp_path]))
    assert "of 547 templates and phrases unused (besides 60 phrases that fit no scene)" in text
