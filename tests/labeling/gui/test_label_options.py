"""Options of `codediffuser label` about references: what is refused, and with which words."""

from __future__ import annotations

from pathlib import Path

import pytest

from codediffuser import cli


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--weights", "x.pth"], "--weights and --references need --features NAME"),
        (["--references", "x.json"], "--weights and --references need --features NAME"),
        (["--features", "dinov"], "Did you mean 'dinov2'?"),
        (["--source", "references"], "--source references needs --features NAME"),
        (["--source", "orcle"], "Did you mean 'oracle'?"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    run: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["label", str(run), *words]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
