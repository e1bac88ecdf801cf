"""What a set of scenes is drawn by, in one value that files can store and compare."""

from __future__ import annotations

from typing import Literal, get_args

from codediffuser.datagen.scene import Split, TemplateSplit
from codediffuser.errors import ConfigError
from codediffuser.registry import unknown_name
from codediffuser.schema import Strict
from codediffuser.seeding import Stage

Factor = Literal["kind", "template", "picks", "places", "target_place", "start"]
"""What `--stratify` can spread evenly."""


class SamplingSettings(Strict):
    """Everything besides the task and the sentences that decides what a scene of an index is."""

    root_seed: int
    """Seed of the whole run, >= 0."""
    stage: str = Stage.SCENE.name
    """Keeps scenes for different uses apart: `SCENE` or `EVAL_SCENE`."""
    variant: str = "sim"
    """Which ranges of the task's YAML to draw from."""
    split: Split = "all"
    """Part of the configuration space; `all` and `eval` are the whole of it."""
    template_split: TemplateSplit | None = None
    """Which sentences; None is all."""
    picks: int | None = None
    """How many objects can be picked; None draws it."""
    places: int | None = None
    """How many places are free; None draws it."""
    stratify: tuple[Factor, ...] = ()
    """Factors whose levels are spread evenly over consecutive indices."""


def parse_factors(names: tuple[str, ...]) -> tuple[Factor, ...]:
    """Check names that a user typed.

    Raises:
        ConfigError: A name is unknown or given twice.
    """
    known: tuple[Factor, ...] = get_args(Factor)
    for name in names:
        if name not in known:
            raise ConfigError(f"stratify: {unknown_name('factor', name, list(known))}")
    if len(set(names)) < len(names):
        raise ConfigError(f"stratify: expected each factor once, got {', '.join(names)}")
    return tuple(factor for factor in known if factor in names)
