"""The numbered examples run as they stand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
ARGUMENTS = {
    "01_sample_scenes": ["--out", "{tmp}"],
    "02_run_an_expert": ["--task", "hang_mug", "--scenes", "1"],
    "03_step_the_environment": ["--out", "{tmp}/after.png"],
    "04_words_to_targets": [],
    "05_attention_over_time": ["--run", "{tmp}"],
    "06_evaluate_your_own_policy": ["--scenes", "1"],
}
"""Small sizes of each; a new example has to be entered."""
WORDS = {
    "01_sample_scenes": "stow_book, real: ",
    "02_run_an_expert": "success: True",
    "03_step_the_environment": "success: True",
    "04_words_to_targets": "refused: the program is not allowed: line 1",
    "05_attention_over_time": "recorded: 000000 success",
    "06_evaluate_your_own_policy": "success\n1 of 1",
}
"""What each prints if it does what it says."""


def test_every_example_is_run_here() -> None:
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    assert names == sorted(ARGUMENTS) == sorted(WORDS)


@pytest.mark.sim
@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_example_does_what_it_says(name: str, tmp_path: Path) -> None:
    words = [word.format(tmp=tmp_path) for word in ARGUMENTS[name]]
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), *words], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert WORDS[name] in done.stdout
