"""Train a policy from an export: deterministic, resumable, one generator of progress."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from codediffuser.errors import CheckpointError, ConfigError
from codediffuser.manifest import git_commit, versions
from codediffuser.training.checkpoint import (
    MODEL_FOLDER,
    STATE_FOLDER,
    latest_checkpoint,
    save_checkpoint,
)
from codediffuser.training.config import TrainConfig
from codediffuser.training.run_folder import (
    TrainRecord,
    claim_folder,
    dataset_root,
    output_folder,
)
from codediffuser.training.training_log import append_row, cut_log, plot_log

if TYPE_CHECKING:
    from torch import Tensor

    from codediffuser.datasets.cache import WindowCache
    from codediffuser.training.policy_document import PolicyDocument
    from codediffuser.training.trainer import Trainer, Validation, Windows

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TrainProgress:
    """Where a training is."""

    step: int
    total_steps: int
    loss: float
    """Mean over the steps since the last report; NaN when there was nothing left to do."""
    lr: float
    steps_per_s: float
    eta_s: float
    val_loss: float | None = None
    val_error_mm: float | None = None
    """Mean distance of planned and demonstrated hand positions on held-out episodes."""
    checkpoint: Path | None = None
    """The checkpoint that was just written."""


def train(
    run: Path, config: TrainConfig, out: Path | None = None, *, overwrite: bool = False
) -> Iterator[TrainProgress]:
    """Train, or continue where the newest whole checkpoint in `out` is.

    A training may be killed at any moment; calling this again goes on with the same losses as if it
    had not been.

    Args:
        run: A run with `lerobot/`, or a LeRobot export.
        config: What to do.
        out: Folder for checkpoints, log and curves; None takes `output_folder`.
        overwrite: Delete what an earlier training left in `out`.

    Yields:
        Progress, every `log_every_steps` and with each checkpoint; the last one is the end.

    Raises:
        DatasetError: There is no usable export.
        ConfigError: Wrong options, or `out` belongs to another training.
        CheckpointError: The newest checkpoint cannot be read.
        SetupError: A GPU is asked for and there is none.
    """
    from codediffuser.datasets.cache import WindowCache

    run = Path(run)
    out = Path(out) if out is not None else output_folder(run, config)
    with _threads(config.num_threads):
        cache = WindowCache.open(dataset_root(run))
        train_on, hold_out = _split(cache, config)
        trainer, check = _prepare(cache, config, train_on, hold_out)
        with contextlib.closing(trainer):
            if trainer.writes:
                record = _record(cache, config, train_on, hold_out)
                claim_folder(out, record, overwrite=overwrite)
            trainer.accelerator.wait_for_everyone()
            _resume(trainer, out)
            yield from _steps(trainer, check, out, _document(cache, len(train_on)))


def _steps(
    trainer: Trainer, check: Windows | None, out: Path, document: PolicyDocument
) -> Iterator[TrainProgress]:
    """The loop itself: steps, and at their intervals reports, validations and checkpoints.

    A report's mean loss starts anew at every report, so it is the same after a continuation.
    """
    config, total = trainer.config, trainer.total_steps
    if trainer.step >= total or _over_time(trainer, 0.0):
        yield TrainProgress(trainer.step, total, math.nan, trainer.learning_rate, 0.0, 0.0)
        return
    losses, started, ends = [], time.perf_counter(), False
    while not ends:
        losses.append(trainer.train_step())
        spent_s = time.perf_counter() - started
        ends = trainer.step == total or _over_time(trainer, spent_s)
        saves = ends or trainer.step % config.checkpoint_every_steps == 0
        checks = ends or trainer.step % config.validate_every_steps == 0
        if not (saves or checks or trainer.step % config.log_every_steps == 0):
            continue
        trainer.elapsed_s += spent_s
        measured = trainer.validate(check) if checks and check is not None else None
        progress = _progress(trainer, losses, spent_s, measured)
        if trainer.writes:
            progress = _write(trainer, out, progress, document if saves else None)
        yield progress
        losses, started = [], time.perf_counter()


def _over_time(trainer: Trainer, spent_s: float) -> bool:
    limit = trainer.config.max_minutes
    return limit is not None and trainer.any_process(trainer.elapsed_s + spent_s >= 60 * limit)


def _write(
    trainer: Trainer, out: Path, progress: TrainProgress, document: PolicyDocument | None
) -> TrainProgress:
    """Write a row of the log and, given a document, a checkpoint."""
    append_row(out, {**asdict(progress), "checkpoint": None, "elapsed_s": trainer.elapsed_s})
    if document is None:
        return progress
    folder = save_checkpoint(out, trainer, document, trainer.config.keep_checkpoints)
    plot_log(out)
    return replace(progress, checkpoint=folder)


def _progress(
    trainer: Trainer, losses: list[Tensor], spent_s: float, measured: Validation | None
) -> TrainProgress:
    loss = float(sum(losses)) / len(losses)
    if not math.isfinite(loss):
        raise ConfigError(
            f"training step {trainer.step}: the loss is {loss}; lower policy.optimizer_lr or set "
            "mixed_precision to 'no', and start anew with --overwrite"
        )
    rate = len(losses) / spent_s
    return TrainProgress(
        step=trainer.step,
        total_steps=trainer.total_steps,
        loss=loss,
        lr=trainer.learning_rate,
        steps_per_s=rate,
        eta_s=(trainer.total_steps - trainer.step) / rate,
        val_loss=measured.loss if measured else None,
        val_error_mm=measured.error_mm if measured else None,
    )


def _split(cache: WindowCache, config: TrainConfig) -> tuple[list[int], list[int]]:
    """Positions of the episodes to learn from and of those to hold out."""
    from codediffuser.datasets.splits import split_episodes

    if config.validation_share == 0 or len(cache.episode_ids) < 2:
        return list(range(len(cache.episode_ids))), []
    train_on, hold_out = split_episodes(cache.episode_ids, config.validation_share)
    return list(train_on), list(hold_out)


def _record(
    cache: WindowCache, config: TrainConfig, train_on: list[int], hold_out: list[int]
) -> TrainRecord:
    return TrainRecord(
        config=config,
        dataset_fingerprint=cache.fingerprint,
        train_episodes=tuple(cache.episode_ids[i] for i in train_on),
        validation_episodes=tuple(cache.episode_ids[i] for i in hold_out),
        versions=versions(),
        git_commit=git_commit(),
    )


def _document(cache: WindowCache, num_episodes: int) -> PolicyDocument:
    from codediffuser.training.policy_document import PolicyDocument

    return PolicyDocument(
        task=cache.document.task if cache.document else None,
        cloud=cache.cloud,
        dataset_fingerprint=cache.fingerprint,
        episodes=num_episodes,
        versions=versions(),
        git_commit=git_commit(),
    )


def _prepare(
    cache: WindowCache, config: TrainConfig, train_on: list[int], hold_out: list[int]
) -> tuple[Trainer, Windows | None]:
    """Build the trainer and the windows to check with."""
    from codediffuser.training.build import policy_config
    from codediffuser.training.policies.attention_diffusion.frame import measure_ranges
    from codediffuser.training.trainer import Trainer

    options = policy_config(config.policy, cache.points[0].size, config.device)
    shape = {"n_obs_steps": options.n_obs_steps, "horizon": options.horizon}
    ranges = measure_ranges(
        cache.state, cache.action, cache.episode_starts, frame=options.frame, **shape
    )
    trainer = Trainer(config, options, ranges, cache.windows(train_on, **shape))
    return trainer, cache.windows(hold_out, **shape) if hold_out else None


def _resume(trainer: Trainer, out: Path) -> None:
    """Go on from the newest whole checkpoint, if there is one."""
    from safetensors import SafetensorError

    newest = latest_checkpoint(out)
    if newest is not None:
        try:
            trainer.load(newest / MODEL_FOLDER, newest / STATE_FOLDER)
        except (OSError, ValueError, KeyError, RuntimeError, SafetensorError) as error:
            raise CheckpointError(
                f"{newest}: cannot be continued: {error}; delete this folder to go on from the "
                "one before, or start anew with --overwrite"
            ) from None
        logger.info("continuing at step %d from %s", trainer.step, newest)
    if trainer.writes:
        cut_log(out, trainer.step)


@contextlib.contextmanager
def _threads(count: int | None) -> Iterator[None]:
    """Let one torch operation use `count` threads for a block."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
