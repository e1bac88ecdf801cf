"""Builders of results, so that a test states only what differs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from codediffuser.eval.results import (
    AttentionRecord,
    ConditionValue,
    EvalResults,
    EvalSettings,
    Judgement,
    Reproducibility,
    RolloutResult,
)
from codediffuser.eval.summary import summarize


@pytest.fixture
def make_rollout() -> Callable[..., RolloutResult]:
    """A rollout that succeeded, or that failed where `failure` says."""

    def make(index: int = 0, *, failure: str | None = None, **changes: Any) -> RolloutResult:
        xy = 0.002 if failure is None else 0.041
        values = {
            "scene_id": f"{index:06d}",
            "scene_sha256": f"scene {index}",
            "instruction": "Pick a battery outside the crate into the furthest slot.",
            "kind": "battery_slackness",
            "picks": 2,
            "places": 3,
            "judged_pairs": (("battery_0", "slot_1"), ("battery_1", "slot_1")),
            "attention": AttentionRecord(pair=("battery_0", "slot_1"), right=True, program="x = 1"),
            "final": Judgement(
                pair=("battery_0", "slot_1"),
                conditions=(
                    ConditionValue(name="xy_distance_m", value=xy, threshold=0.03, holds=xy < 0.03),
                ),
                success=failure is None,
            ),
            "ever_success": failure is None,
            "first_success_step": 150 if failure is None else None,
            "followed": failure is None,
            "failure": failure,
            "steps": 240,
        }
        return RolloutResult(**(values | changes))

    return make


@pytest.fixture
def make_results(make_rollout: Callable[..., RolloutResult]) -> Callable[..., EvalResults]:
    """An evaluation of the given rollouts; one success by default."""

    def make(rollouts: Sequence[RolloutResult] | None = None, **settings: Any) -> EvalResults:
        kept = tuple(rollouts if rollouts is not None else [make_rollout()])
        values = {
            "task": "pack_battery", "variant": "sim", "checkpoint": "checkpoints/cpu/000500",
            "checkpoint_sha256": "c0ffee", "attention": "language", "root_seed": 7,
            "num_scenes": len(kept), "max_steps": 240, "image_width": 160, "image_height": 120,
        }  # fmt: skip
        return EvalResults(
            settings=EvalSettings(**(values | settings)),
            reproducibility=Reproducibility(
                codediffuser="0.1.0", git_commit="abc123", versions={"torch": "2.10"},
                platform="Linux", seed_stage="EVAL_SCENE", command="codediffuser eval RUN",
                created_at="2026-01-02T03:04:05Z",
            ),
            summary=summarize(kept),
            rollouts=kept,
        )  # fmt: skip

    return make
