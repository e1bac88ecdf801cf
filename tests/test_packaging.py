"""The wheel holds all that the package needs; the editable install hides what it lacks."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DATA_SUFFIXES = {
    ".yaml", ".json", ".html", ".css", ".js", ".typed", ".safetensors", ".npz", ".vert", ".frag"
}  # fmt: skip

pytestmark = pytest.mark.slow


def copy_of_sources(to: Path) -> Path:
    """Copy what git would commit, links as links, so that building leaves nothing in the tree."""
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        capture_output=True,
        text=True,
        check=True,
    )
    for name in listed.stdout.split("\0"):
        source = ROOT / name
        if name and source.exists():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, to / name, follow_symlinks=False)
    return to


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sources = copy_of_sources(tmp_path_factory.mktemp("sources"))
    out = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", out, sources],
        check=True,
    )
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel's files and nothing else."""
    target = tmp_path_factory.mktemp("installed")
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", target, wheel],
        check=True,
    )
    return target


def run_installed(installed: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python on the installed files, away from the repository."""
    # PYTHONPATH comes before the editable install of the environment that runs the tests.
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=installed.parent,
        env=environment,
    )


def test_the_wheel_owns_one_name_only(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"codediffuser"}
    # LeRobot's plugin is a distribution of its own.
    assert not any("lerobot_plugin" in name for name in names)


def test_the_wheel_holds_every_module_and_data_file_of_the_stages(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    expected = {
        f"codediffuser/{path.relative_to(ROOT)}"
        for stage in ("datagen", "labeling", "datasets", "training", "eval")
        for path in (ROOT / stage).rglob("*")
        if path.is_file()
        and path.suffix in {".py", *DATA_SUFFIXES}
        and not path.is_relative_to(ROOT / "training" / "lerobot_plugin")
    }
    assert len(expected) > 10
    assert expected - inside == set()


def test_the_installed_files_are_those_that_run(installed: Path) -> None:
    done = run_installed(installed, "-c", "import codediffuser; print(codediffuser.__file__)")
    assert Path(done.stdout.strip()).is_relative_to(installed)


def test_the_licence_is_in_the_wheel(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)


def test_help_is_printed_from_the_wheel(installed: Path) -> None:
    done = run_installed(installed, "-m", "codediffuser.cli", "--help")
    assert done.returncode == 0, done.stderr
    assert "quickstart" in done.stdout


def test_scenes_are_sampled_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    command = ["-m", "codediffuser.cli", "sample", "pack_battery", "-n", "2"]
    done = run_installed(installed, *command, "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("[0-9]*.yaml"))) == 2
