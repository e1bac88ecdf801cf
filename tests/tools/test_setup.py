"""The set-up scripts, as far as they can be tried without changing the machine."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

DEB822 = """\
Types: deb
# a comment that names a snapshot
URIs: http://mirror.example/debian-security
Suites: bookworm-security
Components: main
Signed-By: /usr/share/keyrings/debian.gpg

Types: deb
# a comment that names a snapshot
URIs: http://mirror.example/debian
Suites: bookworm bookworm-updates
Components: main contrib
Signed-By: /usr/share/keyrings/debian.gpg
"""


def backports_entry(apt: Path, codename: str = "bookworm") -> subprocess.CompletedProcess[str]:
    script = ROOT / "tools" / "backports_entry.sh"
    return subprocess.run(
        ["bash", str(script), codename, str(apt)], capture_output=True, text=True, check=False
    )


@pytest.fixture
def apt(tmp_path: Path) -> Path:
    (tmp_path / "sources.list.d").mkdir()
    return tmp_path


def test_the_entry_of_this_release_is_copied_with_only_the_suite_changed(apt: Path) -> None:
    (apt / "sources.list.d" / "debian.sources").write_text(DEB822)
    assert backports_entry(apt).stdout == (
        "sources\n"
        "Types: deb\n"
        "URIs: http://mirror.example/debian\n"
        "Suites: bookworm-backports\n"
        "Components: main contrib\n"
        "Signed-By: /usr/share/keyrings/debian.gpg\n"
    )


def test_the_one_line_form_keeps_its_options(apt: Path) -> None:
    (apt / "sources.list").write_text(
        "# deb http://other.example/debian bookworm main\n"
        "deb-src http://mirror.example/debian bookworm main\n"
        "deb http://mirror.example/debian bookworm-security main\n"
        "deb [arch=amd64 signed-by=/k.gpg] http://mirror.example/debian bookworm main non-free\n"
    )
    assert backports_entry(apt).stdout == (
        "list\n"
        "deb [arch=amd64 signed-by=/k.gpg] http://mirror.example/debian"
        " bookworm-backports main non-free\n"
    )


@pytest.mark.parametrize(
    "change", [("Types: deb", "Types: deb-src"), ("Types: deb", "Enabled: no\nTypes: deb")]
)
def test_source_packages_and_disabled_entries_are_passed_over(
    apt: Path, change: tuple[str, str]
) -> None:
    (apt / "sources.list.d" / "debian.sources").write_text(DEB822.replace(*change))
    assert backports_entry(apt).returncode == 1


def test_a_machine_without_the_entry_is_told(apt: Path) -> None:
    done = backports_entry(apt)
    assert done.returncode == 1
    assert "found no entry for the suite 'bookworm' to copy" in done.stderr


@pytest.mark.parametrize("script", ["tools/setup.sh", "tools/backports_entry.sh", ".ci/run"])
def test_a_script_can_be_run(script: str) -> None:
    path = ROOT / script
    assert path.stat().st_mode & 0o111
    subprocess.run(["bash", "-n", str(path)], check=True)


def test_an_unknown_argument_changes_nothing() -> None:
    done = subprocess.run(
        ["bash", str(ROOT / "tools" / "setup.sh"), "sytem"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "unknown argument 'sytem'" in done.stderr


def test_commits_and_ci_check_the_same() -> None:
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    lint = next(
        line for line in (ROOT / "Makefile").read_text().splitlines() if "check-format " in line
    )
    targets = [word for word in lint.split() if word.startswith("check-")]
    assert targets == ["check-format", "check-lint", "check-types"]
    assert all(f"entry: make {target}" in hooks for target in targets)
    assert "make --no-print-directory lint" in (ROOT / ".ci" / "run").read_text()
