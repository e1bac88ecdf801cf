"""`codediffuser eval`: from instruction to motion in unseen scenes, with a report."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from codediffuser.errors import BelowTargetError, ConfigError
from codediffuser.verbs.verb import NumEpisodes, Verb, console, track


@dataclass(kw_only=True)
class Eval(Verb):
    """Roll the policy out in scenes it has not seen, and write results.json and report.html.

    Scenes come from seeds that collection never uses; the same --seed gives the same scenes to
    every policy, so that two evaluations can be paired. Running again continues.

    Example: codediffuser eval runs/pack -n 50 --workers 2
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with checkpoints/ and lerobot/."""
    num_episodes: NumEpisodes = 50
    """How many scenes. More continue an evaluation."""
    checkpoint: Path | None = None
    """Folder of a training or of one checkpoint. Default: the newest in RUN/checkpoints."""
    attention: Literal["language", "oracle"] = "language"
    """Where attention comes from: the instruction by a program, or the scene's own target."""
    language_model: str = "builtin"
    """Who writes the programs; `builtin` needs no network."""
    stress: Literal["none", "zeroed", "swapped"] = "none"
    """Damage to the attention: all of it gone, or a share of its points swapped for wrong ones."""
    swap_share: float = 0.15
    """That share, with --stress swapped."""
    seed: int = 0
    """Root seed of the scenes."""
    name: str | None = None
    """Folder under RUN/eval. Default: made of checkpoint, attention and stress."""
    workers: int = 1
    """Processes."""
    no_videos: bool = False
    """Leave out the film of each rollout."""
    max_steps: int | None = None
    """Control steps of a rollout. Default: the task's."""
    overwrite: bool = False
    """Forget the evaluation of this name."""
    min_success: float = 0.0
    """Exit with code 3 below this success rate (0 to 1, last state of each rollout)."""

    def run(self) -> Path:
        """Evaluate and return the report."""
        from codediffuser.eval.plan import EvalOptions, evaluation_folder, plan_evaluation
        from codediffuser.eval.results import EvalResults
        from codediffuser.eval.runner import REPORT_FILE, RESULTS_FILE, evaluate

        if self.num_episodes < 1:
            raise ConfigError(f"--num-episodes: expected at least 1, got {self.num_episodes}")
        options = EvalOptions(
            checkpoint=self.checkpoint, name=self.name, attention=self.attention,
            language_model=self.language_model, stress=self.stress, swap_share=self.swap_share,
            num_scenes=self.num_episodes, seed=self.seed, max_steps=self.max_steps,
        )  # fmt: skip
        plan = plan_evaluation(self.run_folder, options)
        folder = evaluation_folder(self.run_folder, plan, self.name)
        rollouts = evaluate(
            plan, folder, workers=self.workers, videos=not self.no_videos,
            overwrite=self.overwrite, command=shlex.join(["codediffuser", *sys.argv[1:]]),
        )  # fmt: skip
        for _ in track(rollouts, "eval", self.num_episodes):
            pass
        rate = EvalResults.load(folder / RESULTS_FILE).summary.success
        console.print(
            f"success {rate.successes} of {rate.trials}, "
            f"{rate.share or 0.0:.0%} [{rate.low:.0%}, {rate.high:.0%}]"
        )
        share = rate.share or 0.0
        if share < self.min_success:
            raise BelowTargetError(
                f"success {share:.0%}, below the --min-success of {self.min_success:.0%}; "
                f"see {folder / REPORT_FILE}"
            )
        return folder / REPORT_FILE
