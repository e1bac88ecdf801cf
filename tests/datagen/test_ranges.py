from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from codediffuser.datagen.task import TASKS, get_task
from codediffuser.errors import ConfigError
from codediffuser.schema import dump_yaml

Keys = tuple[str | int, ...]
POINTS = {"high_m", "low_m", "right", "front", "position_m", "bevel_m"}
"""Pairs of numbers in the YAML files that are points and vectors."""


def ranges_in(raw: Any, keys: Keys = ()) -> Iterator[Keys]:
    """Keys of every pair of two different numbers that is no point."""
    if isinstance(raw, dict):
        for key, value in raw.items():
            if key not in POINTS:
                yield from ranges_in(value, (*keys, key))
    elif isinstance(raw, list):
        if len(raw) == 2 and all(isinstance(n, int | float) for n in raw) and raw[0] != raw[1]:
            yield keys
        for index, value in enumerate(raw):
            yield from ranges_in(value, (*keys, index))


def turned(raw: Any, keys: Keys) -> Any:
    """A copy in which one range has its ends exchanged."""
    changed = holder = copy.deepcopy(raw)
    for key in keys[:-1]:
        holder = holder[key]
    holder[keys[-1]] = holder[keys[-1]][::-1]
    return changed


@pytest.mark.parametrize("task_name", sorted(TASKS))
def test_every_range_that_is_upside_down_is_refused(task_name: str) -> None:
    config = get_task(task_name).config
    raw = config.model_dump(mode="json", by_alias=True)
    found = list(ranges_in(raw))
    assert len(found) > 4
    for keys in found:
        with pytest.raises(ValidationError, match=r"expected \[low, high\] with low <= high"):
            type(config).model_validate(turned(raw, keys))


def test_the_message_names_file_and_key(tmp_path: Path) -> None:
    task = get_task("hang_mug")
    raw = task.config.model_dump(mode="json", by_alias=True)
    path = tmp_path / "task.yaml"
    path.write_text(dump_yaml(turned(raw, ("variants", "real", "areas", 0, "x_m"))))
    with pytest.raises(
        ConfigError, match=r"task.yaml: key 'variants.real.areas.0.x_m': expected .*low <="
    ):
        task.load_config(path)
