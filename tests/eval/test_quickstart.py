"""The whole chain, tiny: scene -> demo -> label -> dataset -> two training steps -> one rollout."""

import pytest

from codediffuser.eval.quickstart import (
    STAGES,
    QuickstartOptions,
    StageProgress,
    quickstart_report,
    run_quickstart,
)
from codediffuser.eval.results import EvalResults

OPTIONS = QuickstartOptions(num_demos=2, train_steps=2, num_rollouts=1, workers=1)


@pytest.fixture(scope="module")
def quickstart(tmp_path_factory):
    out = tmp_path_factory.mktemp("quickstart") / "run"
    return out, list(run_quickstart(out, OPTIONS))


@pytest.mark.sim
@pytest.mark.slow
def test_chain_ends_with_a_report_of_every_rollout(quickstart):
    out, progress = quickstart
    ended = [p.stage for p in progress if p.done == p.total]
    assert list(dict.fromkeys(ended)) == list(STAGES)
    report = quickstart_report(out)
    assert "data:image/jpeg;base64," in report.read_text()
    results = EvalResults.load(report.with_name("results.json"))
    assert results.summary.success.trials == 1
    assert results.settings.attention == "language"
    assert results.settings.checkpoint.endswith("checkpoints/cpu/000002/pretrained_model")
    assert (results.settings.image_width, results.settings.image_height) == (160, 120)


@pytest.mark.sim
@pytest.mark.slow
def test_chain_run_again_repeats_nothing(quickstart):
    out, first = quickstart
    rollout = out / "eval" / "quickstart" / "rollouts" / "000000" / "rollout.json"
    episode = out / "episodes" / "000000" / "episode.mcap"
    checkpoint = out / "checkpoints" / "cpu" / "000002" / "pretrained_model" / "model.safetensors"
    before = [path.stat().st_mtime_ns for path in (rollout, episode, checkpoint)]
    again = list(run_quickstart(out, OPTIONS))
    assert [path.stat().st_mtime_ns for path in (rollout, episode, checkpoint)] == before
    assert StageProgress("train", 2, 2, "trained earlier") in again
    assert again[-1] == first[-1]
