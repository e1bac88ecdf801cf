"""What one rollout and one evaluation leave behind, as files that anyone can read.

`rollout.json` is `codediffuser.rollout/1`, `results.json` is `codediffuser.eval/1`; the report is
drawn from the latter alone.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator

from codediffuser.datagen.scene import Pair
from codediffuser.datagen.task import Check
from codediffuser.schema import Document, Strict

AttentionFrom = Literal["oracle", "language"]
"""Who chooses the targets: the scene file, or the instruction by way of a program."""

Stress = Literal["none", "zeroed", "swapped"]
"""What is done to the attention channels before the policy sees them."""


def _finite_or_none(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


Measured = Annotated[float | None, BeforeValidator(_finite_or_none)]
"""A number, or null where the simulation gave none; JSON has no NaN."""


class ConditionValue(Strict):
    """One measured condition of success."""

    name: str
    value: Measured
    threshold: float
    holds: bool


class Judgement(Strict):
    """The conditions of the pair that came nearest to success."""

    pair: Pair | None
    conditions: tuple[ConditionValue, ...]
    success: bool

    @classmethod
    def from_check(cls, check: Check) -> Judgement:
        """Keep a task's check."""
        values = tuple(
            ConditionValue(name=c.name, value=c.value, threshold=c.threshold, holds=c.holds)
            for c in check.conditions
        )
        return cls(pair=check.pair, conditions=values, success=check.success)


class AttentionRecord(Strict):
    """What the policy attended to, and how that came about."""

    pair: Pair | None = None
    """The chosen (object, place); None when none could be chosen."""
    right: bool = False
    """Whether the pair is one that the instruction allows."""
    program: str | None = None
    """The program that the language model wrote; None for the oracle."""
    seconds: float = 0.0


class RolloutResult(Document):
    """One policy in one scene (`schema: codediffuser.rollout/1`)."""

    KIND: ClassVar[str] = "rollout"
    VERSION: ClassVar[int] = 1

    scene_id: str
    scene_sha256: str
    instruction: str
    kind: str
    """Slackness kind of the instruction."""
    picks: int
    """How many objects could have been picked, before any words."""
    places: int
    """How many places could have taken one, before any words."""
    judged_pairs: tuple[Pair, ...]
    """Pairs that count as success: those the instruction allows, or the oracle's one."""
    attention: AttentionRecord
    final: Judgement | None = None
    """The last state; None when the rollout never began."""
    ever_success: bool = False
    """Whether the conditions held at any control step: the reference release's looser measure."""
    first_success_step: int | None = None
    followed: bool = False
    """Whether the last state satisfies the attended pair, be it the right one or not."""
    failure: str | None = None
    """`phase:what happened`, or None for a success."""
    detail: str = ""
    """One line of explanation when the rollout ended early."""
    steps: int = 0
    """Control steps that were executed."""
    observations: int = 0
    """Clouds that were made: one for the first plan, two for each later one (history)."""
    ik_failures: int = 0
    """Steps whose commanded pose had no joint solution, so that the arm held still."""
    wall_s: float = 0.0
    render_s: float = 0.0
    policy_s: float = 0.0
    video: str | None = None
    """File name in the rollout's folder."""
    keyframes: str | None = None
    """File name of the strip of pictures in the rollout's folder."""

    @property
    def success(self) -> bool:
        """Whether every condition holds in the last state."""
        return self.final is not None and self.final.success and self.failure is None

    @property
    def note(self) -> str:
        """A few words for a progress line."""
        return f"{self.scene_id} {self.failure or 'success'}"


class EvalSettings(Strict):
    """Everything that decides the outcome of an evaluation, and so what may be continued."""

    task: str
    variant: str
    checkpoint: str
    """Path as given, for people."""
    checkpoint_sha256: str
    """Over the names and bytes of all files of the checkpoint."""
    attention: AttentionFrom
    stress: Stress = "none"
    language_model: str | None = None
    """Registered name of who writes the programs; None for the oracle."""
    swap_share: float = 0.0
    """Share of attended points that stress `swapped` replaces by wrong ones."""
    root_seed: int
    num_scenes: int
    max_steps: int
    image_width: int
    image_height: int
    num_inference_steps: int | None = None
    """DDIM steps; None for the checkpoint's own."""


class Reproducibility(Strict):
    """What a reader needs to get the same numbers."""

    codediffuser: str
    git_commit: str
    versions: dict[str, str]
    platform: str
    seed_stage: str
    """Stage of the seed address of the scenes; never the one of collection."""
    command: str
    created_at: str
    """ISO 8601, UTC."""


class RateValue(Strict):
    """A share with its Wilson 95 % interval."""

    successes: int
    trials: int
    share: float | None
    low: float
    high: float


class CellValue(Strict):
    """Success among scenes with this many possible picks and places."""

    picks: int
    places: int
    successes: int
    trials: int


class ConditionSummary(Strict):
    """How the last states stand to one condition."""

    name: str
    threshold: float
    holds: int
    median: Measured
    p90: Measured
    values: tuple[Measured, ...]
    """In the order of the rollouts that were judged."""


class ComparisonValue(Strict):
    """This evaluation (a) against another of the same scenes (b)."""

    name: str
    success_a: RateValue
    success_b: RateValue
    both: int
    only_a: int
    only_b: int
    neither: int
    p_value: float


class Summary(Strict):
    """Every number that the report shows, derived from the rollouts."""

    success: RateValue
    """All conditions hold in the last state."""
    ever_success: RateValue
    """All conditions held at some control step."""
    attention_right: RateValue
    followed: RateValue
    """Did what the attention said, right or wrong."""
    success_given_attention_right: RateValue
    by_kind: dict[str, RateValue]
    attention_by_kind: dict[str, RateValue]
    by_ambiguity: tuple[CellValue, ...]
    failures: dict[str, int]
    conditions: tuple[ConditionSummary, ...]
    ik_failures: int
    rollouts_with_ik_failures: int
    median_wall_s: Measured
    median_success_step: Measured


class EvalResults(Document):
    """One evaluation (`schema: codediffuser.eval/1`)."""

    KIND: ClassVar[str] = "eval"
    VERSION: ClassVar[int] = 1

    settings: EvalSettings
    reproducibility: Reproducibility
    summary: Summary
    comparisons: tuple[ComparisonValue, ...] = ()
    rollouts: tuple[RolloutResult, ...]
