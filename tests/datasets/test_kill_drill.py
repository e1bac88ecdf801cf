"""Verbs are killed while they write; the call after each kill makes up for it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from codediffuser.datasets.kill_drill import ConvertDrill, Kill, Options, drill
from codediffuser.errors import DatasetError


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["convert", "merge"])
def test_the_call_after_a_killed_one_ends_equal(
    verb: str, labelled_run: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "drill").mkdir()
    options = Options(run=labelled_run(2), verbs=(verb,), kills=1)  # type: ignore[arg-type]
    kills = list(drill(options, tmp_path / "drill"))
    assert [kill.verb for kill in kills] == [verb] and kills[0].after_s >= 0


def test_what_differs_is_named(
    labelled_run: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Forgetful(ConvertDrill):
        calls = 0

        def contents(self) -> dict[str, str]:
            Forgetful.calls += 1
            return {"a": "1", "b": str(Forgetful.calls)}

    options = Options(run=labelled_run(1), kills=1)
    monkeypatch.setattr(Forgetful, "_start", lambda self: _Ended())
    with pytest.raises(DatasetError, match=r"convert: after a kill at .* s these differ: b$"):
        list(Forgetful(options, tmp_path / "drill").kill_and_repeat())


def test_a_kill_says_itself() -> None:
    assert (
        str(Kill("merge", 0.5, False, 7)) == "merge    killed after  0.50 s,   7 files were there"
    )


class _Ended:
    """A call that was faster than anybody."""

    def poll(self) -> int:
        return 0

    def wait(self, timeout: float | None = None) -> int:
        return 0
