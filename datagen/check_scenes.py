"""Read sets of scenes back and check each one anew: geometry, words, splits, coverage.

Run as `python -m codediffuser.datagen.check_scenes FOLDER [FOLDER ...] [--workers N]`; exit code 3
when something is wrong. Several folders of one task count together for coverage.
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from codediffuser.datagen.configuration_split import configuration_split
from codediffuser.datagen.instructions.phrasebook import expand_phrases
from codediffuser.datagen.instructions.template_file import LIBRARY_PATH
from codediffuser.datagen.instructions.templates import Template, TemplateLibrary, load_templates
from codediffuser.datagen.overlap import OverlapChecker
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_oracle import meaning
from codediffuser.datagen.task import Task, get_task
from codediffuser.errors import CodeDiffuserError, ConfigError

MIN_LEAD_M = 0.004
"""Words that tell by distance must have at least this lead over the next candidate."""

HEADINGS = (
    "unreadable", "overlaps", "sentences that differ from their template",
    "unsatisfied instructions", "non-unique phrases", "scenes outside of their split",
)  # fmt: skip


@dataclass(slots=True)
class SceneReport:
    """What is wrong with one scene, by heading, and what it says."""

    task: str
    variant: str
    template: str
    words: tuple[tuple[str, str], ...]
    """(Category, words), mentioned ones too."""
    findings: list[tuple[str, str]] = field(default_factory=list)
    """(Heading, which scene and why)."""
    unknown_words: tuple[str, ...] = ()


@dataclass(slots=True)
class SetReport:
    """All of it."""

    scenes: Counter[str] = field(default_factory=Counter)
    """`<task>/<variant>`: how many."""
    findings: dict[str, list[str]] = field(
        default_factory=lambda: {heading: [] for heading in HEADINGS}
    )
    unknown_words: Counter[str] = field(default_factory=Counter)
    templates: dict[str, Counter[str]] = field(default_factory=dict)
    words: dict[str, Counter[tuple[str, str]]] = field(default_factory=dict)
    seconds: float = 0.0

    def add(self, report: SceneReport) -> None:
        """Count one scene."""
        self.scenes[f"{report.task}/{report.variant}"] += 1
        for heading, text in report.findings:
            self.findings[heading].append(text)
        self.unknown_words.update(report.unknown_words)
        self.templates.setdefault(report.task, Counter())[report.template] += 1
        self.words.setdefault(report.task, Counter()).update(report.words)

    @property
    def clean(self) -> bool:
        """Whether nothing was found and every word could be checked."""
        return not any(self.findings.values()) and not self.unknown_words


def check_scene(path: Path, templates: Path = LIBRARY_PATH) -> SceneReport:
    """Check one file; nothing that the sampler stores of pairs or clearances is believed."""
    try:
        scene = SceneSpec.load(path)
        task, checker, library = _tools(scene.task, templates)
    except CodeDiffuserError as error:
        return SceneReport("unknown", "unknown", "", (), [("unreadable", str(error))])
    said = scene.instruction
    words = tuple((p.removeprefix("other_"), w) for p, w in said.components.items())
    report = SceneReport(scene.task, scene.variant, said.template_id, words)
    found = report.findings
    for one, other in checker.overlaps(scene):
        found.append(("overlaps", f"{path}: {one} and {other}"))
    for name in checker.below_table(scene):
        found.append(("overlaps", f"{path}: {name} and the table"))
    template = library.get(said.template_id)
    if template is None or template.fill(said.components) != said.text:
        found.append((HEADINGS[2], f"{path}: {said.text!r}"))
    elif (template.split, template.kind) != (said.template_split, said.kind):
        found.append((HEADINGS[2], f"{path}: stores another kind or split than the library"))
    _check_words(scene, task, path, report)
    if scene.split in ("train", "val", "held_out"):
        x, y, _ = scene.object(scene.target.pick).position_m
        split = configuration_split(task.config.splits, (x, y), scene.target.place)
        if split != scene.split:
            found.append((HEADINGS[5], f"{path}: {scene.split}, should be {split}"))
    return report


def _check_words(scene: SceneSpec, task: Task, path: Path, report: SceneReport) -> None:
    """Compare what is stored with what the words allow."""
    said = scene.instruction
    meant = meaning(scene, task.config.observer, task.pick_category)
    report.unknown_words = meant.unknown_words
    if meant.unknown_words:
        return
    if meant.empty_words or meant.smallest_lead_m < MIN_LEAD_M:
        report.findings.append(
            (HEADINGS[4], f"{path}: {said.text!r}: {', '.join(meant.empty_words) or 'a near tie'}")
        )
    allowed = meant.pairs
    target = (scene.target.pick, scene.target.place)
    mentioned = {f"{pick}>{place}" for pick, place in allowed} | {pick for pick, _ in allowed}
    if allowed != set(said.pairs) or target not in allowed or mentioned & meant.other_ids:
        report.findings.append((HEADINGS[3], f"{path}: {said.text!r}"))


@functools.cache
def _tools(task_name: str, templates: Path) -> tuple[Task, OverlapChecker, dict[str, Template]]:
    task = get_task(task_name)
    library = {t.id: t for t in load_templates(task_name, templates).templates}
    return task, OverlapChecker(task), library


def check_scenes(
    folders: Sequence[Path], *, workers: int = 1, templates: Path = LIBRARY_PATH
) -> SetReport:
    """Check every scene of some folders.

    Raises:
        ConfigError: A folder holds no scene.
    """
    paths: list[Path] = []
    for folder in folders:
        found = sorted(p for p in folder.glob("*.yaml") if not p.name.startswith("."))
        if not found:
            raise ConfigError(f"{folder}: no scene in it; sample some with 'codediffuser sample'")
        paths += found
    report, start = SetReport(), time.perf_counter()
    for one in _run(functools.partial(check_scene, templates=templates), paths, workers):
        report.add(one)
    report.seconds = time.perf_counter() - start
    return report


def _run(
    check: functools.partial[SceneReport], paths: Sequence[Path], workers: int
) -> Iterator[SceneReport]:
    if workers <= 1:
        yield from map(check, paths)
        return
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(check, paths, chunksize=64)


def unused(report: SetReport, task_name: str, library: TemplateLibrary) -> tuple[list[str], int]:
    """Templates and phrases of a library that no checked scene of its task uses.

    Returns:
        names: What is unused, of that which some scene could use.
        total: How many there are of these.
    """
    task = get_task(task_name)
    phrases, never = expand_phrases(task, library), task.never_said()
    every = [
        (category, words) for category, known in phrases.items() for words in known
        if words not in never
    ]  # fmt: skip
    names = [t.id for t in library.templates if t.id not in report.templates[task_name]]
    names += [
        words for category, words in every if (category, words) not in report.words[task_name]
    ]
    return names, len(library.templates) + len(every)


def describe(report: SetReport, templates: Path = LIBRARY_PATH) -> str:
    """The report as lines for people."""
    total = sum(report.scenes.values())
    lines = [f"{total} scenes read and checked, {total / report.seconds:.0f} scenes/s"]
    lines += [f"  {name}: {count}" for name, count in sorted(report.scenes.items())]
    for heading, found in report.findings.items():
        lines += [f"{heading}: {len(found)}", *(f"  {text}" for text in found[:5])]
    lines.append(f"words that no rule of the checker knows: {sum(report.unknown_words.values())}")
    lines += [f"  {words}: {count}" for words, count in report.unknown_words.most_common(5)]
    for task_name in sorted(report.templates.keys() - {"unknown"}):
        names, known = unused(report, task_name, load_templates(task_name, templates))
        never = len(get_task(task_name).never_said())
        besides = f" (besides {never} phrases that fit no scene)" if never else ""
        lines.append(f"{task_name}: {len(names)} of {known} templates and phrases unused{besides}")
        lines += [f"  {name}" for name in names[:10]]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Check folders and print what was found."""
    parser = argparse.ArgumentParser(prog="python -m codediffuser.datagen.check_scenes")
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--templates", type=Path, default=LIBRARY_PATH)
    options = parser.parse_args(arguments)
    try:
        report = check_scenes(options.folders, workers=options.workers, templates=options.templates)
        text = describe(report, options.templates)
    except CodeDiffuserError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    sys.stdout.write(text + "\n")
    return 0 if report.clean else 3


if __name__ == "__main__":
    sys.exit(main())
