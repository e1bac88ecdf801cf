"""Facts about where attention comes from, without a simulator."""

import pytest

from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.errors import LanguageModelError, NotRegisteredError
from codediffuser.eval.attention_source import LanguageSource, OracleSource, source_for
from codediffuser.labeling.language import LanguageModel, Limits
from codediffuser.seeding import Stage


class Parrot(LanguageModel):
    """Replies with one text, whatever it is asked."""

    name = "parrot"
    repairs = False

    def __init__(self, text):
        self.text = text

    def reply(self, prompt):
        if isinstance(self.text, Exception):
            raise self.text
        return self.text


@pytest.fixture(scope="module")
def task():
    return get_task("pack_battery")


@pytest.fixture(scope="module")
def scenes(task):
    return [
        sample_scene(task, root_seed=1, index=i, stage=Stage.EVAL_SCENE, split="eval")
        for i in range(12)
    ]


def say(scene, text):
    return scene.model_copy(
        update={"instruction": scene.instruction.model_copy(update={"text": text})}
    )


def test_oracle_gives_and_judges_the_target_alone(task, scenes):
    for scene in scenes:
        target = (scene.target.pick, scene.target.place)
        assert OracleSource().choose(task, scene).pair == target
        assert OracleSource().judged_pairs(scene) == [target]


def test_instruction_leads_to_an_allowed_pair(task, scenes):
    source = LanguageSource()
    for scene in scenes:
        choice = source.choose(task, scene)
        assert choice.pair in source.judged_pairs(scene), scene.instruction.text
        assert "output_var" in choice.program
        assert (choice.failure, choice.detail) == ("", "")
        assert choice.seconds > 0


def test_language_does_not_look_at_the_target(task, scenes):
    for scene in scenes:
        if scene.ambiguity.places > 1:
            other = next(p.id for p in scene.free_places if p.id != scene.target.place)
            target = scene.target.model_copy(update={"place": other})
            moved = scene.model_copy(update={"target": target})
            assert (
                LanguageSource().choose(task, moved).pair
                == LanguageSource().choose(task, scene).pair
            )


@pytest.mark.parametrize(
    "text", ["Pick the red battery outside the crate into a slot.", "Sing a song.", "", "x" * 5000]
)
def test_instruction_that_fits_nothing_is_a_failure_that_says_why(task, scenes, text):
    choice = LanguageSource().choose(task, say(scenes[0], text))
    assert choice.pair is None
    assert choice.failure == "language:fits_nothing"
    assert choice.detail


@pytest.fixture
def little_patience(monkeypatch):
    monkeypatch.setattr("codediffuser.eval.attention_source.LIMITS", Limits(seconds=0.3))


@pytest.mark.parametrize(
    "program",
    [
        "import os\noutput_var = []",
        "n = 0\nfor i in range(10 ** 9):\n    n = n + 1\noutput_var = []",
        "output_var = 7",
        "no code at all",
    ],
)
def test_program_that_is_no_answer_is_a_failure_with_its_text(
    little_patience, task, scenes, program
):
    choice = LanguageSource(Parrot(program)).choose(task, scenes[0])
    assert (choice.pair, choice.failure) == (None, "language:program")
    assert choice.program == program


def test_model_that_is_away_is_a_failure(task, scenes):
    choice = LanguageSource(Parrot(LanguageModelError("no route"))).choose(task, scenes[0])
    assert (choice.failure, choice.detail) == ("language:no_answer", "no route")
    assert choice.program is None


def test_source_is_found_by_name():
    assert isinstance(source_for("oracle"), OracleSource)
    assert isinstance(source_for("language"), LanguageSource)
    with pytest.raises(NotRegisteredError, match="builtin"):
        source_for("language", "buildin")
