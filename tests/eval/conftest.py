"""Builders of results, so that a test states only what differs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.export_meta import DatasetDocument
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
from codediffuser.files import write_json


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


@pytest.fixture
def eval_run(tmp_path: Path) -> Path:
    """A run folder with an export's documents and a checkpoint that cannot be loaded."""
    run = tmp_path / "run"
    write_json(run / "lerobot" / "meta" / "info.json", {"codebase_version": "v3.0", "features": {}})
    DatasetDocument(
        profile="pointcloud", task="pack_battery", cloud=CloudConfig(), source="run", episodes=(),
        left_out=(), versions={}, git_commit="abc", content_sha256="def",
    ).save(run / "lerobot" / "meta" / "codediffuser.json")  # fmt: skip
    model = run / "checkpoints" / "cpu" / "000500" / "pretrained_model"
    write_json(model / "config.json", {"type": "attention_diffusion"})
    return run


@pytest.fixture
def random_checkpoint(eval_run: Path) -> Path:
    """The same run with a small policy of random weights as its newest checkpoint."""
    import numpy as np
    import torch

    from codediffuser.training.build import policy_config
    from codediffuser.training.policies.attention_diffusion import frame as frames
    from codediffuser.training.policies.attention_diffusion import (
        modeling_attention_diffusion as modeling,
    )
    from codediffuser.training.policies.attention_diffusion import (
        processor_attention_diffusion as processor,
    )

    options = {
        "type": "attention_diffusion", "down_dims": [16, 32], "encoder_dim": 16,
        "num_inference_steps": 2, "crop_pick_points": 8, "crop_place_points": 8,
        "crop_hand_points": 8,
    }  # fmt: skip
    config = policy_config(options, CloudConfig().num_points * 5, "cpu")
    low, high = np.full(10, -0.05, np.float32), np.full(10, 0.05, np.float32)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        policy = modeling.AttentionDiffusionPolicy(
            config, ranges=frames.PoseRanges(low, high, low, high)
        )
    folder = eval_run / "checkpoints" / "random" / "000001" / "pretrained_model"
    policy.save_pretrained(folder)
    for pipeline in processor.make_attention_diffusion_pre_post_processors(policy.config):
        pipeline.save_pretrained(folder)
    return eval_run
