"""Merges are killed while they write."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from codediffuser.datasets.merging.kill_drill import Options, drill


@pytest.mark.slow
def test_a_merge_after_killed_ones_equals_an_undisturbed_one(
    make_video_dataset: Callable[..., Path], tmp_path: Path
) -> None:
    dataset = make_video_dataset(tmp_path / "dataset")
    (tmp_path / "drill").mkdir()
    kills = list(drill(Options(dataset=dataset, shards=2, kills=2), tmp_path / "drill"))
    assert len(kills) == 2 and all(kill.after_s >= 0 for kill in kills)
