"""Progress where no terminal is: in a log one reads how far a long piece of work is."""

from __future__ import annotations

import pytest

from codediffuser.verbs import verb


@pytest.mark.parametrize(
    ("told_every_s", "counts"), [(0.0, ["1/3", "2/3", "3/3"]), (30.0, ["3/3"])]
)
def test_a_log_gets_a_line_now_and_then(
    told_every_s: float, counts: list[str],
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(verb, "TOLD_EVERY_S", told_every_s)
    assert list(verb.track(iter("abc"), "spelling", 3)) == ["a", "b", "c"]
    lines = [line.split() for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert [line[0] for line in lines] == ["spelling"] * len(counts)
    assert [line[2] for line in lines] == counts
