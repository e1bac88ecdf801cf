"""Many rollouts in worker processes: kept one by one, continued after an interruption."""

from __future__ import annotations

import datetime
import functools
import logging
import os
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from codediffuser import __version__
from codediffuser.datagen.workers import Outcome, run_tasks
from codediffuser.errors import CodeDiffuserError
from codediffuser.eval.attention_source import source_for
from codediffuser.eval.plan import EvalPlan, claim_folder
from codediffuser.eval.report import write_report
from codediffuser.eval.results import (
    AttentionRecord,
    EvalResults,
    Reproducibility,
    RolloutResult,
)
from codediffuser.eval.rollout import ClosedLoop, RolloutOptions, RolloutRun, scene_facts
from codediffuser.eval.summary import compare_results, summarize
from codediffuser.files import atomic_folder
from codediffuser.manifest import git_commit, versions
from codediffuser.seeding import Stage

TIMEOUT_S = 600.0
"""A rollout takes seconds; a worker that is silent for so long is killed."""

RESULT_FILE, RESULTS_FILE, REPORT_FILE = "rollout.json", "results.json", "report.html"
VIDEO_FILE, STRIP_FILE = "video.mp4", "keyframes.jpg"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Job:
    """One rollout, as it is sent to a worker."""

    plan_file: Path
    folder: Path
    index: int
    videos: bool


def evaluate(
    plan: EvalPlan,
    folder: Path,
    *,
    workers: int = 1,
    videos: bool = True,
    overwrite: bool = False,
    command: str = "",
) -> Iterator[RolloutResult]:
    """Run what is missing, yield every rollout, then write `results.json` and `report.html`.

    Finished rollouts in `folder/rollouts/` are yielded first and not run again. Words that fit
    nothing, programs that loop and policies that answer NaN are failed rollouts. A rollout whose
    process died twice is counted as failed but not kept, so that the next call tries it again.

    Args:
        plan: What is evaluated.
        folder: Where it goes; see `evaluation_folder`.
        workers: Processes; changes nothing but the time.
        videos: Whether to draw a film of each rollout.
        overwrite: Forget the evaluation that is there.
        command: Command line for the report's reproducibility block.

    Raises:
        ConfigError: The folder holds an evaluation with other settings.
        CheckpointError: The policy cannot be loaded.
        SetupError: The machine cannot render.
    """
    claim_folder(folder, plan, overwrite=overwrite)
    results: dict[int, RolloutResult] = {}
    for index, result in _finished(plan, folder):
        results[index] = result
        yield result
    missing = [i for i in range(plan.settings.num_scenes) if i not in results]
    jobs = [Job(folder / "plan.json", folder, index, videos) for index in missing]
    for outcome in run_tasks(run_job, jobs, workers=workers, timeout_s=TIMEOUT_S):
        result = outcome.value or _lost(plan, outcome)
        results[outcome.task.index] = result
        yield result
    finish([results[i] for i in sorted(results)], plan, folder, command)


def finish(
    rollouts: Sequence[RolloutResult], plan: EvalPlan, folder: Path, command: str
) -> EvalResults:
    """Write `results.json` and `report.html`, compared with sibling evaluations of the scenes."""
    results = EvalResults(
        settings=plan.settings,
        reproducibility=Reproducibility(
            codediffuser=__version__,
            git_commit=git_commit(),
            versions=versions(),
            platform=f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
            seed_stage=Stage.EVAL_SCENE.name,
            command=command or f"codediffuser eval {folder.parent.parent}",
            created_at=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        ),
        summary=summarize(rollouts),
        rollouts=tuple(rollouts),
    )
    results = compare_results(results, _siblings(folder))
    results.save(folder / RESULTS_FILE)
    write_report(results, folder)
    return results


def run_job(job: Job) -> RolloutResult:
    """Run one rollout in a worker and keep it, whole or not at all."""
    worker = _worker(job.plan_file, job.videos)
    run = worker.loop.run(worker.plan.scene(worker.loop.task, job.index))
    return worker.keep(run, job.folder / "rollouts" / run.scene.scene_id)


@functools.lru_cache(maxsize=1)
def _worker(plan_file: Path, videos: bool) -> _Worker:
    return _Worker(EvalPlan.load(plan_file), videos)


class _Worker:
    """What a process builds once: policy, simulator, renderers."""

    def __init__(self, plan: EvalPlan, videos: bool) -> None:
        import torch

        from codediffuser.eval.policy_handle import CheckpointPolicy

        # Rollouts scale by processes; threads of several policies would wait for each other.
        torch.set_num_threads(1)
        self.plan = plan
        settings, task = plan.settings, plan.task_object()
        policy = CheckpointPolicy(
            Path(settings.checkpoint), num_inference_steps=settings.num_inference_steps
        )
        options = RolloutOptions(settings.max_steps, settings.stress, settings.swap_share)
        self.loop = ClosedLoop(
            task, policy, source_for(settings.attention, settings.language_model), options,
            cameras=plan.cameras(task), cloud=plan.cloud,
        )  # fmt: skip
        self.film_renderer = None
        if videos:
            from codediffuser.datagen.rendering import Renderer
            from codediffuser.eval.film import film_cameras

            self.film_renderer = Renderer(task, film_cameras(task))

    def keep(self, run: RolloutRun, folder: Path) -> RolloutResult:
        """Write the rollout's folder and return its result with the names of its pictures."""
        with atomic_folder(folder) as partial:
            run.scene.save(partial / "scene.yaml")
            result = run.result
            if run.trajectory is not None:
                run.trajectory.save(partial / "states.npz")
                if self.film_renderer is not None:
                    self._draw(run, partial)
                    update = {"video": VIDEO_FILE, "keyframes": STRIP_FILE}
                    result = result.model_copy(update=update)
            result.save(partial / RESULT_FILE)
        return result

    def _draw(self, run: RolloutRun, folder: Path) -> None:
        from codediffuser.eval.film import FPS, film
        from codediffuser.eval.video import key_frame_strip
        from codediffuser.video import write_video

        assert run.trajectory is not None and run.field is not None
        assert self.film_renderer is not None
        pair = run.result.attention.pair
        shots = list(
            film(
                self.film_renderer, run.scene, run.trajectory, run.field,
                instruction=run.result.instruction, attended=pair or (),
                holds=run.holds,
            )
        )  # fmt: skip
        write_video((frame for frame, _ in shots), folder / VIDEO_FILE, fps=FPS)
        (folder / STRIP_FILE).write_bytes(key_frame_strip([picture for _, picture in shots]))


def _finished(plan: EvalPlan, folder: Path) -> Iterator[tuple[int, RolloutResult]]:
    """Rollouts of this plan that are whole on disk, in order."""
    for index in range(plan.settings.num_scenes):
        path = folder / "rollouts" / f"{index:06d}" / RESULT_FILE
        if path.is_file():
            yield index, RolloutResult.load(path)


def _lost(plan: EvalPlan, outcome: Outcome[Job, RolloutResult]) -> RolloutResult:
    """Count a rollout whose process gave no answer."""
    source = source_for(plan.settings.attention, plan.settings.language_model)
    scene = plan.scene(plan.task_object(), outcome.task.index)
    _log.error("rollout %s: %s", scene.scene_id, outcome.error)
    return RolloutResult(
        **scene_facts(scene, source.judged_pairs(scene)),
        attention=AttentionRecord(),
        failure="worker:error" if outcome.fate == "error" else "worker:died",
        detail=f"after {outcome.tries} tries: {outcome.reason}",
    )


def _siblings(folder: Path) -> Iterator[tuple[str, EvalResults]]:
    """Other finished evaluations of the same run; unreadable ones are left out."""
    for path in sorted(folder.parent.glob(f"*/{RESULTS_FILE}")):
        if path.parent == folder:
            continue
        try:
            yield path.parent.name, EvalResults.load(path)
        except CodeDiffuserError as error:
            _log.warning("not compared with %s: %s", path.parent.name, error)
