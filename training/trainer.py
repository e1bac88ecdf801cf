"""One training in progress: a step, a validation, save and load."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from accelerate import Accelerator
from accelerate.state import AcceleratorState, PartialState
from torch import Tensor

from codediffuser.datasets.features import ACTION
from codediffuser.files import write_json
from codediffuser.seeding import Stage, int_seed, rng_for
from codediffuser.training.config import TrainConfig
from codediffuser.training.ema import WeightAverage
from codediffuser.training.policies.attention_diffusion.configuration_attention_diffusion import (
    AttentionDiffusionConfig,
)
from codediffuser.training.policies.attention_diffusion.frame import PoseRanges
from codediffuser.training.policies.attention_diffusion.modeling_attention_diffusion import (
    AttentionDiffusionPolicy,
)
from codediffuser.training.policies.attention_diffusion.processor_attention_diffusion import (
    make_attention_diffusion_pre_post_processors,
)
from codediffuser.training.prefetch import Prefetcher

if TYPE_CHECKING:
    from lerobot.optim.schedulers import LRScheduler

VALIDATION_WINDOWS = 128
RAW_WEIGHTS = "raw_model.safetensors"
"""Weights before averaging, which the optimiser goes on from."""
CLOCK = "elapsed.json"


class Windows(Protocol):
    """What a trainer needs of `datasets.cache.WindowSampler`."""

    def __len__(self) -> int:
        """Frames to draw from."""

    def sample(self, rng: np.random.Generator, batch_size: int) -> dict[str, np.ndarray]:
        """Draw windows."""


@dataclass(frozen=True, slots=True)
class Validation:
    """Numbers on held-out episodes, with the averaged weights."""

    loss: float
    error_mm: float
    """Mean distance between carried-out and demonstrated hand positions."""


class Trainer:
    """Network, optimiser, schedule and weight average of one training.

    Every random number of step n belongs to the address (seed, TRAIN, n), so a continued training
    goes on exactly as if it had not stopped, and nothing random has to be saved.

    Args:
        config: The run.
        options: Of the policy.
        ranges: Ranges of the poses in the policy's frame.
        windows: What to learn from.
    """

    def __init__(
        self,
        config: TrainConfig,
        options: AttentionDiffusionConfig,
        ranges: PoseRanges,
        windows: Windows,
    ) -> None:
        self.config = config
        self.step = 0
        self.elapsed_s = 0.0
        """Seconds spent training, earlier sittings included."""
        self.accelerator = _accelerator(config)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int_seed(rng_for(config.seed, Stage.TRAIN)))
            policy = AttentionDiffusionPolicy(options, ranges=ranges)
        self.policy = policy.to(self.accelerator.device)
        self.total_steps, schedule_steps = config.planned_steps(
            len(windows), self.accelerator.num_processes
        )
        preset = options.get_optimizer_preset()
        self._clip = preset.grad_clip_norm
        self._plain_optimizer = preset.build(policy.get_optim_params())
        for group in self._plain_optimizer.param_groups:
            group["fused"] = True  # one pass over all weights: 2 ms a step instead of 6
        self._schedule: LRScheduler = options.get_scheduler_preset().build(
            self._plain_optimizer, schedule_steps
        )
        self._average = WeightAverage(policy, config.ema)
        self._model, self._optimizer = self.accelerator.prepare(policy, self._plain_optimizer)
        self._windows = windows
        self._batches = Prefetcher(self._draw)

    @property
    def writes(self) -> bool:
        """Whether this process writes files; of several, one does."""
        return bool(self.accelerator.is_main_process)

    def any_process(self, flag: bool) -> bool:
        """Whether any of the processes says so; all get the same answer."""
        if self.accelerator.num_processes == 1:
            return flag
        said = torch.tensor(float(flag), device=self.accelerator.device)
        return bool(self.accelerator.reduce(said, "sum") > 0)

    @property
    def learning_rate(self) -> float:
        """Of the next step."""
        return float(self._schedule.get_last_lr()[0])

    def train_step(self) -> Tensor:
        """Take one optimiser step and return its loss, detached."""
        batch, seed = self._batches.get(self.step + 1)
        self._model.train()
        with self._seeded(seed), self.accelerator.autocast():
            loss, _ = self._model(self._to_device(batch))
        self.accelerator.backward(loss)
        if self._clip > 0:
            self.accelerator.clip_grad_norm_(self._model.parameters(), self._clip)
        self._optimizer.step()
        self._schedule.step()
        self._optimizer.zero_grad()
        self.step += 1
        self._average.update(self.step)
        return loss.detach()

    @torch.no_grad()
    def validate(self, windows: Windows) -> Validation:
        """Measure the averaged policy on a fixed draw of held-out windows."""
        rng = rng_for(self.config.seed, Stage.TRAIN, 0, 1)
        batch = self._to_device(windows.sample(rng, VALIDATION_WINDOWS))
        policy = self.policy.eval()
        start = policy.config.n_obs_steps - 1
        with self._average.applied(), self._seeded(int_seed(rng)):
            loss, _ = policy(batch)
            planned = policy.predict_action_chunk(batch)
        shown = batch[ACTION][:, start : start + planned.shape[1]]
        error = (planned - shown)[..., :3].norm(dim=-1).mean()
        return Validation(loss=float(loss), error_mm=float(error) * 1000)

    def save(self, model_folder: Path, state_folder: Path) -> None:
        """Write the averaged policy with its processors, and all that going on needs."""
        from lerobot.utils.train_utils import save_training_state
        from safetensors.torch import save_model

        with self._average.applied():
            self.policy.save_pretrained(model_folder)
        for pipeline in make_attention_diffusion_pre_post_processors(self.policy.config):
            pipeline.save_pretrained(model_folder)
        save_training_state(state_folder.parent, self.step, self._plain_optimizer, self._schedule)
        save_model(self.policy, str(state_folder / RAW_WEIGHTS))
        write_json(state_folder / CLOCK, {"elapsed_s": self.elapsed_s})

    def load(self, model_folder: Path, state_folder: Path) -> None:
        """Go on from what `save` wrote."""
        from lerobot.utils.train_utils import load_training_state
        from safetensors.torch import load_model

        device = self.accelerator.device.type
        load_model(self.policy, str(model_folder / "model.safetensors"), device=device)
        self._average.restart()
        load_model(self.policy, str(state_folder / RAW_WEIGHTS), device=device)
        self.step, _, _ = load_training_state(
            state_folder.parent, self._plain_optimizer, self._schedule
        )
        clock = json.loads((state_folder / CLOCK).read_text(encoding="utf-8"))
        self.elapsed_s = float(clock["elapsed_s"])

    def close(self) -> None:
        """Stop what runs in the background."""
        self._batches.close()

    def _draw(self, step: int) -> tuple[dict[str, np.ndarray], int]:
        """Batch of a step, and the seed of torch's numbers in it."""
        rng = rng_for(self.config.seed, Stage.TRAIN, step, self.accelerator.process_index)
        return self._windows.sample(rng, self.config.batch_size), int_seed(rng)

    def _to_device(self, batch: dict[str, np.ndarray]) -> dict[str, Tensor]:
        device = self.accelerator.device
        return {key: torch.from_numpy(value).to(device) for key, value in batch.items()}

    @contextlib.contextmanager
    def _seeded(self, seed: int) -> Iterator[None]:
        """Draw torch's numbers from a seed for a block; the caller's generators are kept."""
        device = self.accelerator.device
        with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
            torch.manual_seed(seed)
            yield


def _accelerator(config: TrainConfig) -> Accelerator:
    """Set torch up for a training, whatever an earlier one in this process, ours or not, asked for.

    accelerate keeps one state for a process and refuses another precision or device.
    """
    if AcceleratorState._shared_state and PartialState().num_processes == 1:
        state = AcceleratorState()
        if (state.mixed_precision, state.device.type) != (config.mixed_precision, config.device):
            AcceleratorState._reset_state(reset_partial_state=True)
    return Accelerator(
        cpu=config.device == "cpu",
        mixed_precision=config.mixed_precision,
        step_scheduler_with_optimizer=False,
    )
