"""The import law: one direction, heavy libraries where they belong, light modules stay light."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
STAGES = ("datagen", "labeling", "datasets", "training", "eval")
CORE = "core"
FACE = "face"
"""The command line: above all stages, imported by none."""

OWNERS = {
    "sapien": {"datagen"},
    "mani_skill": {"datagen"},
    "torch": {"datagen", "labeling", "datasets", "training", "eval", FACE},
    "lerobot": {"datasets", "training", "eval"},
    "viser": {"labeling", "datasets"},
}
"""Heavy libraries and who may import them, at the top of a module or inside a function."""

VISER_MODULES = {"views.py", "panels.py", "app.py"}

LIGHT_MODULES = (
    "codediffuser.cli",
    "codediffuser.doctor",
    "codediffuser.errors",
    "codediffuser.files",
    "codediffuser.manifest",
    "codediffuser.pointcloud",
    "codediffuser.poses",
    "codediffuser.registry",
    "codediffuser.schema",
    "codediffuser.seeding",
    "codediffuser.datagen.scene",
    "codediffuser.datagen.scene_sampler",
    "codediffuser.datagen.task",
    "codediffuser.datagen.tasks",
    "codediffuser.datagen.trajectory",
    "codediffuser.datagen.episode",
    "codediffuser.labeling.label",
    "codediffuser.labeling.store",
    "codediffuser.datasets.features",
    "codediffuser.eval.metrics",
)
HEAVY = ("torch", "sapien", "mani_skill", "viser", "lerobot", "open3d", "matplotlib", "datasets")


def sources() -> Iterator[tuple[str, Path]]:
    """Each Python file with the part of the project that it belongs to."""
    for path in sorted((ROOT / "codediffuser").glob("*.py")):
        yield (FACE if path.name == "cli.py" else CORE), path
    for path in sorted((ROOT / "codediffuser" / "verbs").glob("*.py")):
        yield FACE, path
    for stage in STAGES:
        for path in sorted((ROOT / stage).rglob("*.py")):
            yield stage, path


def imports(path: Path) -> Iterator[tuple[str, int]]:
    """Full names of all imported modules and their lines, wherever in the file they stand."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            for alias in node.names:
                yield f"{node.module}.{alias.name}", node.lineno


def part_of(module: str) -> str | None:
    """The part of the project that a module's name belongs to; None for other packages."""
    words = module.split(".")
    if words[0] != "codediffuser":
        return None
    if len(words) == 1 or words[1] not in (*STAGES, "cli", "verbs"):
        return CORE
    return words[1] if words[1] in STAGES else FACE


def test_there_is_something_to_look_at() -> None:
    assert {part for part, _ in sources()} == {CORE, FACE, *STAGES}


def test_imports_point_one_way() -> None:
    order = (CORE, *STAGES, FACE)
    wrong = [
        f"{path.relative_to(ROOT)}:{line}: {part} imports {module}"
        for part, path in sources()
        for module, line in imports(path)
        if (other := part_of(module)) and order.index(other) > order.index(part)
    ]
    assert wrong == []


@pytest.mark.parametrize("library", OWNERS)
def test_a_heavy_library_is_imported_only_where_it_belongs(library: str) -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line}"
        for part, path in sources()
        for module, line in imports(path)
        if module.split(".")[0] == library and part not in OWNERS[library]
    ]
    assert wrong == []


def test_only_the_three_modules_of_the_browser_window_know_viser() -> None:
    users = {
        path.name for _, path in sources() for m, _ in imports(path) if m.split(".")[0] == "viser"
    }
    assert users <= VISER_MODULES


def test_relative_imports_are_not_used() -> None:
    # They would find the stage folder under another name than `codediffuser.<stage>`.
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for _, path in sources()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.level > 0
    ]
    assert wrong == []


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_folder_is_reached_by_its_link_and_has_no_init(stage: str) -> None:
    # A regular package `datasets` beside the root would hide Hugging Face datasets from LeRobot.
    assert not (ROOT / stage / "__init__.py").exists()
    link = ROOT / "codediffuser" / stage
    assert link.is_symlink()
    assert link.readlink() == Path("..") / stage


LOAD = """
import importlib, json, sys
modules, heavy = json.loads(sys.argv[1])
brought = {}
for name in modules:
    importlib.import_module(name)
    # Shown for the first module that brings it: the modules are loaded one after the other.
    for library in heavy:
        if library in sys.modules:
            brought.setdefault(library, name)
print(json.dumps(brought))
"""


def test_light_modules_load_nothing_heavy() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOAD, json.dumps([LIGHT_MODULES, HEAVY])],
        capture_output=True,
        text=True,
        check=False,
        cwd="/",
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {}


def test_hugging_face_datasets_is_found_beside_the_repository_root() -> None:
    code = "import datasets; print(datasets.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert "site-packages" in done.stdout
