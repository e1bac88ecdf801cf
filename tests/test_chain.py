"""The whole chain at its smallest: scene to rollout through the command line, in CI."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from codediffuser import cli
from codediffuser.eval.results import EvalResults


@pytest.mark.sim
@pytest.mark.slow
def test_chain_from_scene_to_report(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path_factory.mktemp("chain")

    def call(*words: str) -> str:
        assert cli.run(list(words)) == 0, capsys.readouterr().err
        return capsys.readouterr().out.strip()

    assert call("sample", "pack_battery", "-n", "3", "--out", f"{run}/scenes") == f"{run}/scenes"
    assert call("demo", str(run), "--size", "160x120", "--min-success", "1") == f"{run}/episodes"
    assert call("label", str(run), "--auto") == f"{run}/episodes"
    assert call("convert", str(run)) == f"{run}/lerobot"
    assert call("validate", str(run)) == f"{run}: nothing wrong"
    call("train", str(run), "--steps", "2", "--num-threads", "1")
    report = Path(call("eval", str(run), "-n", "1", "--max-steps", "24"))

    assert report.is_file()
    results = EvalResults.load(report.parent / "results.json")
    assert results.rollouts[0].attention.right
    frames = json.loads((run / "lerobot" / "meta" / "info.json").read_text())["total_frames"]
    assert frames == 3 * 185
