"""Facts about plans and about many rollouts: kept, continued, counted, compared."""

import json
import shutil

import pytest

from codediffuser.datagen.workers import Outcome
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.errors import CheckpointError, ConfigError, DatasetError
from codediffuser.eval import runner
from codediffuser.eval.plan import (
    EvalOptions,
    EvalPlan,
    evaluation_folder,
    newest_training,
    plan_evaluation,
)
from codediffuser.eval.results import EvalResults, RolloutResult
from codediffuser.eval.rollout import RolloutRun, scene_facts
from codediffuser.eval.runner import evaluate
from codediffuser.files import write_json
from codediffuser.training.checkpoint import POLICY_FILE
from codediffuser.training.policy_document import PolicyDocument


class FakeLoop:
    """Succeeds in even scenes, and remembers which it ran."""

    def __init__(self, task, make_rollout):
        self.task, self.make, self.ran = task, make_rollout, []

    def run(self, scene):
        index = scene.seed.index
        self.ran.append(index)
        failure = "place:on_rim" if index % 2 else None
        return RolloutRun(scene, self.make(index, failure=failure, **scene_facts(scene, ())))


@pytest.fixture
def fake_workers(monkeypatch, make_rollout):
    """Rollouts without simulator, policy or processes; `dies` names scenes whose process dies."""
    loop = FakeLoop(EvalPlan.task_object.__get__, make_rollout)
    loop.dies = set()

    def build(plan_file, videos):
        worker = object.__new__(runner._Worker)
        worker.plan, worker.loop, worker.film_renderer = EvalPlan.load(plan_file), loop, None
        loop.task = worker.plan.task_object()
        return worker

    def inline(function, tasks, **_):
        for task in tasks:
            if task.index in loop.dies:
                yield Outcome(task, None, "process killed by SIGKILL", 2)
            else:
                yield Outcome(task, function(task), "", 1)

    monkeypatch.setattr(runner, "_worker", build)
    monkeypatch.setattr(runner, "run_tasks", inline)
    return loop


def plan_for(run, **options):
    plan = plan_evaluation(run, EvalOptions(**({"num_scenes": 4} | options)))
    return plan, evaluation_folder(run, plan)


def test_evaluation_leaves_rollouts_results_and_report(eval_run, fake_workers):
    plan, folder = plan_for(eval_run, attention="oracle")
    yielded = list(evaluate(plan, folder, command="codediffuser eval run"))
    assert [r.success for r in yielded] == [True, False, True, False]
    assert folder == eval_run / "eval" / "cpu-oracle"
    results = EvalResults.load(folder / "results.json")
    assert [r.scene_id for r in results.rollouts] == ["000000", "000001", "000002", "000003"]
    assert results.summary.failures == {"place:on_rim": 2}
    assert results.reproducibility.seed_stage == "EVAL_SCENE"
    assert "codediffuser eval run" in (folder / "report.html").read_text()
    kept = folder / "rollouts" / "000001"
    assert RolloutResult.load(kept / "rollout.json") == yielded[1]
    assert (kept / "scene.yaml").is_file()


def test_running_again_runs_only_what_is_missing(eval_run, fake_workers):
    plan, folder = plan_for(eval_run)
    interrupted = evaluate(plan, folder)
    next(interrupted), next(interrupted)
    interrupted.close()
    assert not (folder / "results.json").exists()
    (folder / "rollouts" / ".partial-999999999-000003").mkdir()
    fake_workers.ran.clear()
    assert len(list(evaluate(plan, folder))) == 4
    assert fake_workers.ran == [2, 3]
    assert sorted(p.name for p in (folder / "rollouts").iterdir())[0] == "000000"


def test_more_scenes_continue_an_evaluation(eval_run, fake_workers):
    list(evaluate(*plan_for(eval_run, num_scenes=2)))
    fake_workers.ran.clear()
    plan, folder = plan_for(eval_run, num_scenes=5)
    list(evaluate(plan, folder))
    assert fake_workers.ran == [2, 3, 4]
    assert EvalResults.load(folder / "results.json").summary.success.trials == 5


def test_other_settings_in_the_same_folder_are_refused_by_name(eval_run, fake_workers):
    plan, folder = plan_for(eval_run)
    list(evaluate(plan, folder))
    other, _ = plan_for(eval_run, seed=9)
    with pytest.raises(ConfigError, match=r"root_seed 0, now 9.*--overwrite"):
        list(evaluate(other, folder))
    assert len(list(evaluate(other, folder, overwrite=True))) == 4
    assert EvalPlan.load(folder / "plan.json").settings.root_seed == 9


def test_another_checkpoint_under_the_same_name_is_refused(eval_run, fake_workers):
    plan, folder = plan_for(eval_run)
    list(evaluate(plan, folder))
    config = eval_run / "checkpoints" / "cpu" / "000500" / "pretrained_model" / "config.json"
    write_json(config, {"type": "attention_diffusion", "trained": "longer"})
    with pytest.raises(ConfigError, match="checkpoint_sha256"):
        list(evaluate(plan_for(eval_run)[0], folder))


def test_a_process_that_dies_is_a_failed_rollout_and_is_tried_next_time(eval_run, fake_workers):
    fake_workers.dies = {2}
    plan, folder = plan_for(eval_run)
    lost = list(evaluate(plan, folder))[2]
    assert (lost.success, lost.failure) == (False, "worker:died")
    assert lost.detail == "after 2 tries: process killed by SIGKILL"
    assert "worker:died" in (folder / "report.html").read_text()
    fake_workers.dies = set()
    assert [r.failure for r in evaluate(plan, folder)].count("worker:died") == 0


def test_sibling_evaluations_of_the_same_scenes_are_compared(eval_run, fake_workers):
    list(evaluate(*plan_for(eval_run, attention="oracle")))
    list(evaluate(*plan_for(eval_run, seed=5), videos=False))
    plan, folder = plan_for(eval_run, attention="oracle", stress="zeroed")
    (folder.parent / "broken").mkdir()
    (folder.parent / "broken" / "results.json").write_text("{")
    list(evaluate(plan, folder))
    compared = EvalResults.load(folder / "results.json").comparisons
    assert [(c.name, c.both, c.neither) for c in compared] == [("cpu-oracle", 2, 2)]


def test_scenes_of_evaluation_are_paired_and_never_those_of_collection(eval_run):
    from codediffuser.datagen.scene_sampler import sample_scene

    oracle, language = (plan_for(eval_run, attention=a)[0] for a in ("oracle", "language"))
    task = oracle.task_object()
    for index in range(3):
        scene = oracle.scene(task, index)
        assert scene == language.scene(task, index)
        assert scene.split == "eval" and scene.seed.stage == "EVAL_SCENE"
        collected = sample_scene(task, root_seed=0, index=index)
        assert scene.objects != collected.objects


@pytest.mark.parametrize(
    "options, name",
    [
        ({"attention": "oracle"}, "cpu-oracle"),
        ({"attention": "oracle", "stress": "zeroed"}, "cpu-oracle-zeroed"),
        ({"attention": "oracle", "stress": "swapped"}, "cpu-oracle-swapped15"),
        ({}, "cpu-language"),
    ],
)
def test_folder_is_named_after_training_attention_and_stress(eval_run, options, name):
    assert plan_for(eval_run, **options)[1].name == name


def test_pictures_take_the_size_of_the_demonstrations(eval_run, write_synthetic_episode):
    write_synthetic_episode(eval_run)
    plan, _ = plan_for(eval_run)
    assert (plan.settings.image_width, plan.settings.image_height) == (32, 24)
    assert plan.cameras(plan.task_object()).width == 32
    larger, _ = plan_for(eval_run, image_size=(64, 48))
    assert larger.settings.image_width == 64


@pytest.mark.parametrize(
    "options, message",
    [
        ({"num_scenes": 0}, "at least 1, got 0"),
        ({"swap_share": 1.5}, r"share in \(0, 1\], got 1.5"),
    ],
)
def test_options_out_of_range_are_refused(eval_run, options, message):
    with pytest.raises(ConfigError, match=message):
        plan_for(eval_run, **options)


def test_run_without_checkpoint_or_export_says_what_to_do(eval_run, tmp_path):
    with pytest.raises(CheckpointError, match="train one with"):
        newest_training(tmp_path)
    with pytest.raises(CheckpointError, match="no checkpoint here"):
        plan_for(eval_run, checkpoint=tmp_path)
    shutil.rmtree(eval_run / "lerobot")
    with pytest.raises(DatasetError, match="codediffuser convert"):
        plan_for(eval_run)


def test_task_and_clouds_are_those_that_the_checkpoint_learnt(eval_run):
    model = eval_run / "checkpoints" / "cpu" / "000500" / "pretrained_model"
    cloud = CloudConfig(pick_points=64, place_points=64)
    learnt = PolicyDocument(
        task="pack_battery", cloud=cloud, dataset_fingerprint="ab", episodes=2, versions={},
        git_commit="abc",
    )  # fmt: skip
    learnt.save(model / POLICY_FILE)
    assert plan_for(eval_run)[0].cloud == cloud
    shutil.rmtree(eval_run / "lerobot")
    assert plan_for(eval_run)[0].settings.task == "pack_battery"


def test_checkpoint_of_a_dataset_that_lerobot_edited_takes_the_task_of_the_run(eval_run):
    model = eval_run / "checkpoints" / "cpu" / "000500" / "pretrained_model"
    PolicyDocument(
        task=None, cloud=CloudConfig(), dataset_fingerprint="ab", episodes=2, versions={},
        git_commit="abc",
    ).save(model / POLICY_FILE)  # fmt: skip
    assert plan_for(eval_run)[0].settings.task == "pack_battery"


@pytest.mark.sim
@pytest.mark.slow
def test_untrained_policy_is_evaluated_from_words_in_a_process_of_its_own(random_checkpoint):
    plan, folder = plan_for(
        random_checkpoint, checkpoint=random_checkpoint / "checkpoints" / "random",
        num_scenes=1, image_size=(160, 120), max_steps=12,
    )  # fmt: skip
    (result,) = evaluate(plan, folder)
    assert result.failure.startswith(("grasp:", "transport:"))
    assert result.attention.right and "output_var" in result.attention.program
    assert (result.steps, result.observations) == (12, 3)
    home = folder / "rollouts" / "000000"
    assert {p.name for p in home.iterdir()} == {
        "rollout.json", "scene.yaml", "states.npz", "video.mp4", "keyframes.jpg"
    }  # fmt: skip
    report = (folder / "report.html").read_text()
    assert "data:image/jpeg;base64," in report and 'class="mp4"' in report
    assert json.loads((folder / "results.json").read_text())["rollouts"][0]["video"] == "video.mp4"


@pytest.mark.sim
@pytest.mark.slow
def test_checkpoint_of_another_policy_ends_the_evaluation(eval_run):
    config = eval_run / "checkpoints" / "cpu" / "000500" / "pretrained_model" / "config.json"
    write_json(config, {"type": "act"})
    plan, folder = plan_for(eval_run, num_scenes=1)
    with pytest.raises(CheckpointError, match="got 'act'"):
        list(evaluate(plan, folder))
