"""What README and docs promise: Python runs, verbs exist, links lead somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_the_snippet_that_samples_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(SNIPPETS[0], {})
    sentence, pairs = capsys.readouterr().out.splitlines()
    assert sentence.endswith(".")
    assert "battery_" in pairs


@pytest.mark.sim
def test_the_snippet_that_simulates_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(SNIPPETS[1], {})
    assert capsys.readouterr().out == "False\n"


def test_every_verb_has_its_line() -> None:
    from codediffuser.verbs import VERBS

    rows = re.findall(r"^\| `(\w+)` \|", README, re.MULTILINE)
    assert sorted(rows) == sorted(VERBS)


def test_every_command_of_the_chain_is_understood() -> None:
    from codediffuser.cli import parse

    commands = re.findall(r"^codediffuser (.+)$", README, re.MULTILINE)
    assert len(commands) >= 7
    for command in commands:
        verb = parse(command.split())
        assert getattr(verb, "auto", True), "labels come from the simulator so far"


PAGES = ["README.md", "CONTRIBUTING.md", *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("name", sorted(PAGES))
def test_links_lead_to_files(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
    beside = (ROOT / name).parent
    assert [target for target in targets if not (beside / target).exists()] == []
