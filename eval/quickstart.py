"""The whole chain at a small size: sample, demo, label, convert, train, eval.

Each stage is the function behind its verb, so whatever was interrupted is continued by calling
again, and the folder is an ordinary run to go on from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from codediffuser.errors import LabelError

STAGES = ("sample", "demo", "label", "convert", "train", "eval")
EVAL_NAME = "quickstart"
IMAGE_SIZE = (160, 120)


@dataclass(frozen=True, slots=True, kw_only=True)
class QuickstartOptions:
    """Sizes that end within 25 minutes on two cores."""

    task: str = "pack_battery"
    num_demos: int = 64
    train_steps: int = 2400
    max_train_minutes: float = 13.0
    """Training stops there on a slow machine, and the policy is the weaker for it."""
    num_rollouts: int = 12
    seed: int = 0
    workers: int = 2
    """Processes; the training takes one thread."""
    command: str = "codediffuser quickstart"


@dataclass(frozen=True, slots=True)
class StageProgress:
    """Where the chain is."""

    stage: str
    done: int
    total: int
    note: str = ""


def quickstart_report(out: Path) -> Path:
    """Where the report of a quickstart in `out` lies."""
    return out / "eval" / EVAL_NAME / "report.html"


def run_quickstart(out: Path, options: QuickstartOptions | None = None) -> Iterator[StageProgress]:
    """Run all stages in one run folder, continuing what is there.

    Args:
        out: Run folder; made when missing.
        options: Sizes; None takes those that ship.

    Yields:
        Progress of each stage; every stage ends with `done == total`.

    Raises:
        ConfigError: The folder holds a run of other sizes, seed or task.
        SetupError: The machine cannot render.
        CodeDiffuserError: Whatever a stage raises.
    """
    options = options or QuickstartOptions()
    stages: dict[str, Callable[[Path, QuickstartOptions], Iterator[StageProgress]]] = {
        "sample": _sample,
        "demo": _demo,
        "label": _label,
        "convert": _convert,
        "train": _train,
        "eval": _eval,
    }
    for stage in STAGES:
        yield from stages[stage](out, options)


def _sample(out: Path, options: QuickstartOptions) -> Iterator[StageProgress]:
    from codediffuser.datagen.sampling_settings import SamplingSettings
    from codediffuser.datagen.scene_files import sample_scenes
    from codediffuser.datagen.scene_sampler import SceneSource
    from codediffuser.datagen.task import get_task

    source = SceneSource(get_task(options.task), SamplingSettings(root_seed=options.seed))
    paths = sample_scenes(source, out / "scenes", options.num_demos, workers=options.workers)
    for done, path in enumerate(paths, start=1):
        yield StageProgress("sample", done, options.num_demos, path.stem)


def _demo(out: Path, options: QuickstartOptions) -> Iterator[StageProgress]:
    from codediffuser.datagen.collect import CollectOptions, collect_demos, scene_ids
    from codediffuser.datagen.pictures import PictureOptions

    width, height = IMAGE_SIZE
    pictures = PictureOptions(width=width, height=height)
    total = len(scene_ids(out))
    results = collect_demos(out, CollectOptions(pictures=pictures), workers=options.workers)
    for done, result in enumerate(results, start=1):
        yield StageProgress("demo", done, total, f"{result.scene_id} {result.reason}".strip())


def _label(out: Path, options: QuickstartOptions) -> Iterator[StageProgress]:
    from codediffuser.labeling.auto import label_run

    for result in label_run(out, workers=options.workers):
        if result.error:
            raise LabelError(result.error)
        yield StageProgress("label", result.index + 1, result.total, result.episode_id)


def _convert(out: Path, options: QuickstartOptions) -> Iterator[StageProgress]:
    from codediffuser.datasets.convert import convert_run

    for now in convert_run(out, workers=options.workers):
        yield StageProgress("convert", now.done, now.total, now.episode_id)


def _train(out: Path, options: QuickstartOptions) -> Iterator[StageProgress]:
    from codediffuser.training.config import load_preset
    from codediffuser.training.loop import train

    config = load_preset("cpu").with_changes(
        steps=options.train_steps,
        seed=options.seed,
        max_minutes=options.max_train_minutes,
        # Two threads beside any other work wait for each other: 0.1 steps/s instead of 5, seen.
        num_threads=1,
    )
    step = 0
    for now in train(out, config):
        step = now.step
        words = f"loss {now.loss:.4f}, {now.steps_per_s:.1f} steps/s, {now.eta_s / 60:.1f} min left"
        # A loss of NaN stands for no step: the training had ended in an earlier call.
        note = "trained earlier" if math.isnan(now.loss) else words
        yield StageProgress("train", step, options.train_steps, note)
    if step < options.train_steps:
        note = f"stopped at step {step} after {options.max_train_minutes:g} minutes"
        yield StageProgress("train", options.train_steps, options.train_steps, note)


def _eval(out: Path, options: QuickstartOptions) -> Iterator[StageProgress]:
    from codediffuser.eval.plan import EvalOptions, evaluation_folder, plan_evaluation
    from codediffuser.eval.runner import evaluate

    chosen = EvalOptions(
        checkpoint=out / "checkpoints" / "cpu", name=EVAL_NAME, num_scenes=options.num_rollouts,
        seed=options.seed, image_size=IMAGE_SIZE,
    )  # fmt: skip
    plan = plan_evaluation(out, chosen)
    rollouts = evaluate(
        plan, evaluation_folder(out, plan, EVAL_NAME), workers=options.workers,
        command=options.command,
    )  # fmt: skip
    for done, result in enumerate(rollouts, start=1):
        yield StageProgress("eval", done, options.num_rollouts, result.note)
