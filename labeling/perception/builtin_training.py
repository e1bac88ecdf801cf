"""Trains the built-in network on cuts of rendered scenes, in a quarter of an hour on one core."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812  torch's own habit

from codediffuser.labeling.perception.builtin_network import SCALE, BuiltinNetwork, cues
from codediffuser.labeling.perception.builtin_samples import Sample
from codediffuser.labeling.perception.builtin_targets import CATEGORIES, VOTE_SCALE
from codediffuser.seeding import Stage, int_seed, rng_for

RIGHT = 5
"""Input channel that changes sign when a picture is mirrored: the normal's part to the right."""


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """The recipe, stored with the weights."""

    steps: int = 2400
    batch: int = 12
    """Cuts per step."""
    height: int = 128
    """Of a cut, pixels."""
    width: int = 160
    learning_rate: float = 3e-3
    """At its peak, after `warmup`; falls to 0 along a cosine."""
    warmup: int = 60
    weight_decay: float = 1e-3
    instance_share: float = 0.5
    """Share of the cuts that lie around an instance; the others lie anywhere in the workspace."""
    rare_weight: float = 2.0
    """Of each category beside the background, in the loss."""
    contrast: float = 0.3
    brightness: float = 0.2
    """Largest change of a cut's colours."""
    seed: int = 0


@dataclass(frozen=True, slots=True)
class TrainingStep:
    """How training stands."""

    step: int
    category_loss: float
    vote_loss: float
    """Mean over the pixels of instances of the summed errors, in units of `VOTE_SCALE`."""


def train(
    network: BuiltinNetwork, samples: Sequence[Sample], config: TrainingConfig
) -> Iterator[TrainingStep]:
    """Train a network in place; the same samples and recipe give the same network on one thread.

    Args:
        network: As it was built; left in evaluation mode at the end.
        samples: Scenes to cut from, at least one.
        config: The recipe.
    """
    rng = rng_for(config.seed, Stage.TRAIN)
    torch.manual_seed(int_seed(rng))
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda k: _rate(k, config))
    network.train()
    for step in range(1, config.steps + 1):
        cuts = [
            _cut(samples[int(rng.integers(len(samples)))], rng, config) for _ in range(config.batch)
        ]
        inputs, category, votes = (torch.cat(parts) for parts in zip(*cuts, strict=True))
        with torch.autocast("cpu", dtype=torch.bfloat16):
            embeddings, found = network(inputs)
        category_loss, vote_loss = _losses(network, embeddings.float(), found.float(), category,
                                           votes, config)  # fmt: skip
        optimizer.zero_grad()
        (category_loss + vote_loss).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        yield TrainingStep(step, category_loss.item(), vote_loss.item())
    network.eval()


def _rate(step: int, config: TrainingConfig) -> float:
    """Share of the peak learning rate at a step."""
    rising = min(1.0, (step + 1) / config.warmup)
    return float(rising * 0.5 * (1 + np.cos(np.pi * step / config.steps)))


def _losses(
    network: BuiltinNetwork,
    embeddings: Tensor,
    found: Tensor,
    category: Tensor,
    votes: Tensor,
    config: TrainingConfig,
) -> tuple[Tensor, Tensor]:
    weight = torch.full((len(CATEGORIES),), config.rare_weight)
    weight[0] = 1.0
    category_loss = F.cross_entropy(SCALE * network.cosines(embeddings), category, weight=weight)
    instance = category > 0
    error = (found - votes).abs().sum(dim=1)
    return category_loss, (error * instance).sum() / instance.sum().clamp(min=1)


def _cut(
    sample: Sample, rng: np.random.Generator, config: TrainingConfig
) -> tuple[Tensor, Tensor, Tensor]:
    """One cut around some point: cues (1, C, h, w), category (1, h, w), votes (1, 3, h, w)."""
    view = rng.integers(len(sample.rgb))
    wanted = sample.inside[view]
    if rng.uniform() < config.instance_share:
        wanted = wanted & (sample.category[view] > 0)
    candidates = np.flatnonzero(wanted)
    height, width = sample.depth_m.shape[1:]
    at = candidates[rng.integers(len(candidates))] if len(candidates) else height * width // 2
    top = _start(at // width, config.height, height, rng)
    left = _start(at % width, config.width, width, rng)
    window = (view, slice(top, top + config.height), slice(left, left + config.width))
    K = torch.from_numpy(sample.K[view] - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])).float()
    inputs = cues(
        torch.from_numpy(sample.rgb[window])[None],
        torch.from_numpy(sample.depth_m[window])[None],
        K[None],
        torch.from_numpy(sample.T_world_camera[view])[None],
    )
    gain = rng.uniform(1 - config.contrast, 1 + config.contrast, (3, 1, 1)).astype(np.float32)
    shift = rng.uniform(-config.brightness, config.brightness, (3, 1, 1)).astype(np.float32)
    inputs[:, :3] = (inputs[:, :3] + 1) * torch.from_numpy(gain) - 1 + torch.from_numpy(shift)
    inputs[:, :3].clamp_(-1, 1)
    category = torch.from_numpy(sample.category[window].astype(np.int64))[None]
    votes = torch.from_numpy(sample.votes[window].astype(np.float32)).permute(2, 0, 1)[None]
    if rng.uniform() < 0.5:
        inputs, category, votes = inputs.flip(-1), category.flip(-1), votes.flip(-1)
        inputs[:, RIGHT] *= -1
        votes[:, 0] *= -1
    return inputs, category, votes


def _start(around: int, size: int, whole: int, rng: np.random.Generator) -> int:
    """Where a cut begins that holds a row or column, evenly among those that lie in the picture."""
    low = max(0, around - size + 1)
    return int(rng.integers(low, max(low, min(around, whole - size)) + 1))


@torch.no_grad()
def score(network: BuiltinNetwork, samples: Sequence[Sample]) -> dict[str, dict[str, float]]:
    """Quality on scenes that were not trained on, for each category but the background.

    Returns:
        For each category `iou` of its pixels, and `vote_px` and `vote_depth_m`: the 90th percentile
        of the error of its votes across the picture and in depth.
    """
    meeting, union = np.zeros(len(CATEGORIES)), np.zeros(len(CATEGORIES))
    across: list[list[np.ndarray]] = [[] for _ in CATEGORIES]
    for sample in samples:
        inputs = cues(*(torch.from_numpy(a) for a in (
            sample.rgb, sample.depth_m, sample.K, sample.T_world_camera)))  # fmt: skip
        embeddings, votes = network(inputs)
        found = network.cosines(embeddings).argmax(dim=1).numpy()
        error = np.abs(votes.permute(0, 2, 3, 1).numpy() - sample.votes) * VOTE_SCALE
        for k in range(1, len(CATEGORIES)):
            true, mine = (sample.category == k) & sample.inside, (found == k) & sample.inside
            meeting[k] += (true & mine).sum()
            union[k] += (true | mine).sum()
            across[k].append(error[true & (sample.depth_m > 0)])
    scores = {}
    for k, name in enumerate(CATEGORIES[1:], start=1):
        errors = np.concatenate([np.zeros((0, 3)), *across[k]])
        if len(errors):
            px, depth = (
                np.percentile(errors[:, :2].max(axis=1), 90),
                np.percentile(errors[:, 2], 90),
            )
            iou = float(meeting[k] / union[k])
            scores[name] = {"iou": iou, "vote_px": float(px), "vote_depth_m": float(depth)}
    return scores
