"""What a training run does, as a versioned YAML; two presets ship with the package."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from codediffuser.errors import ConfigError
from codediffuser.registry import unknown_name
from codediffuser.schema import Document, Strict, parse_model

PRESET_FOLDER = Path(__file__).parent / "presets"


class EmaConfig(Strict):
    """Moving average of the weights: the model that is saved.

    The decay after n steps is min(max_decay, 1 - (1 + n) ** -power), so the random start is
    forgotten quickly.
    """

    power: float = Field(default=0.75, gt=0)
    max_decay: float = Field(default=0.997, ge=0, lt=1)


class TrainConfig(Document):
    """One training run (`schema: codediffuser.train/1`)."""

    KIND: ClassVar[str] = "train"
    VERSION: ClassVar[int] = 1
    RUNTIME_FIELDS: ClassVar[frozenset[str]] = frozenset(
        {"num_threads", "max_minutes", "log_every_steps", "keep_checkpoints"}
    )
    """Fields that may differ when a run is continued: they change no weight."""

    name: str
    """Folder under `RUN/checkpoints/`."""
    policy: dict[str, Any]
    """`type` and options of the policy, those of its LeRobot configuration class."""
    batch_size: int = Field(default=64, ge=1)
    """Windows per step and process."""
    steps: int | None = Field(default=None, ge=1)
    """Optimiser steps; or give `epochs`."""
    epochs: float | None = Field(default=None, gt=0)
    """Passes over all frames of the training episodes."""
    schedule_epochs: float | None = Field(default=None, gt=0)
    """Length of the learning-rate schedule where it is longer than the training."""
    ema: EmaConfig = EmaConfig()
    seed: int = Field(default=0, ge=0)
    validation_share: float = Field(default=0.05, ge=0, lt=1)
    """Share of the episodes that are held out, chosen by their ids."""
    validate_every_steps: int = Field(default=500, ge=1)
    checkpoint_every_steps: int = Field(default=500, ge=1)
    keep_checkpoints: int = Field(default=2, ge=1)
    """Older ones are deleted when a newer one is whole."""
    log_every_steps: int = Field(default=50, ge=1)
    device: Literal["cpu", "cuda"] = "cpu"
    mixed_precision: Literal["no", "bf16", "fp16"] = "no"
    num_threads: int | None = Field(default=None, ge=1)
    """Threads of one torch operation; None leaves torch's choice."""
    max_minutes: float | None = Field(default=None, gt=0)
    """Stop there and save, wherever the schedule is. A cap for safety: a run that meets it has not
    ended its cosine and is weaker than one of fewer planned steps."""

    @model_validator(mode="after")
    def _one_length(self) -> Self:
        if (self.steps is None) == (self.epochs is None):
            raise ValueError("give either 'steps' or 'epochs'")
        if self.schedule_epochs is not None and self.epochs is None:
            raise ValueError("'schedule_epochs' goes with 'epochs'")
        return self

    def planned_steps(self, num_frames: int, num_processes: int = 1) -> tuple[int, int]:
        """Steps of the training and of the learning-rate schedule.

        Args:
            num_frames: Frames of the training episodes.
            num_processes: Processes that each take a batch per step.
        """
        per_epoch = num_frames / (self.batch_size * num_processes)
        total = self.steps or math.ceil((self.epochs or 0) * per_epoch)
        schedule = math.ceil(self.schedule_epochs * per_epoch) if self.schedule_epochs else total
        return total, max(total, schedule)

    def with_changes(self, **changes: Any) -> TrainConfig:
        """Return a copy with some entries replaced; `policy` options are merged in.

        Giving `steps` drops `epochs` and its schedule, and the other way round.

        Raises:
            ConfigError: An entry is unknown or wrong.
        """
        raw = self.model_dump(by_alias=True)
        if changes.get("steps") is not None:
            raw |= {"epochs": None, "schedule_epochs": None}
        elif changes.get("epochs") is not None:
            raw |= {"steps": None}
        raw["policy"] = raw["policy"] | changes.pop("policy", {})
        return parse_model(TrainConfig, raw | changes, "training options")

    def same_result(self, other: TrainConfig) -> bool:
        """Whether both lead to the same weights."""
        skip = set(self.RUNTIME_FIELDS)
        return self.model_dump(exclude=skip) == other.model_dump(exclude=skip)


def preset_names() -> list[str]:
    """Names of the presets that ship with the package, sorted."""
    return sorted(path.stem for path in PRESET_FOLDER.glob("*.yaml"))


def load_preset(name: str) -> TrainConfig:
    """Read a preset by name, or a file of the same schema by its path (ending in `.yaml`).

    Raises:
        ConfigError: Unknown name, or a file that does not follow the schema.
    """
    if name.endswith((".yaml", ".yml")):
        return TrainConfig.load(Path(name))
    if name not in preset_names():
        raise ConfigError(unknown_name("training preset", name, preset_names()))
    return TrainConfig.load(PRESET_FOLDER / f"{name}.yaml")
