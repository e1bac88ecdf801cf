"""What README and docs promise: Python runs, verbs exist, links lead somewhere."""

import re
import shlex
from importlib.util import find_spec
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


PAGES = ["README.md", "CONTRIBUTING.md", *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("name", sorted(PAGES))
def test_links_lead_to_files(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
    beside = (ROOT / name).parent
    assert [target for target in targets if not (beside / target).exists()] == []


def commands_of(name: str, start: str) -> list[list[str]]:
    """Words of each command in the code of a page that begins with `start`."""
    text = (ROOT / name).read_text(encoding="utf-8")
    blocks = [block.replace("\\\n", " ") for block in re.findall(r"```.*?```", text, re.DOTALL)]
    lines = [line for block in blocks for line in block.splitlines()]
    lines += re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    found = [shlex.split(line, comments=True)[len(start.split()) :]
             for line in lines if line.startswith(f"{start} ")]  # fmt: skip
    return [words for words in found if words and "..." not in words]


def test_the_pages_have_commands() -> None:
    assert len(commands_of("README.md", "codediffuser")) >= 17
    assert len(commands_of("docs/importing.md", "codediffuser")) >= 3


@pytest.mark.parametrize("name", sorted(PAGES))
def test_every_command_is_understood(name: str) -> None:
    from codediffuser.cli import parse

    for words in commands_of(name, "codediffuser"):
        if words[0] != "VERB" and len(words) > 1:
            parse(words)


@pytest.mark.parametrize("name", sorted(PAGES))
def test_every_module_that_is_run_has_the_options_that_are_given(name: str) -> None:
    for module, *words in commands_of(name, "python -m"):
        if not module.startswith("codediffuser."):
            continue
        spec = find_spec(module)
        assert spec is not None and spec.origin is not None, module
        source = Path(spec.origin).read_text(encoding="utf-8")
        assert "__main__" in source, module
        for word in words:
            if word.startswith("--"):
                option = word.removeprefix("--").removeprefix("no-").replace("-", "_")
                assert re.search(rf"\b{option}\b", source), f"{module} has no {word}"
