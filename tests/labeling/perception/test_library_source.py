from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import get_task
from codediffuser.errors import LabelError
from codediffuser.labeling.oracle_source import OracleSource
from codediffuser.labeling.perception.features import FeatureOptions, get_features
from codediffuser.labeling.perception.library_source import LibrarySource
from codediffuser.labeling.perception.references import (
    BACKGROUND,
    ReferenceLibrary,
    make_reference,
)

IMAGE = np.zeros((2, 2, 3), np.uint8)


@pytest.fixture
def episode(write_battery_episode: Callable[..., Path], tmp_path: Path) -> Episode:
    return Episode.open(write_battery_episode(tmp_path))


def write_library(path: Path, episode: Episode, *categories: str) -> None:
    """References of the oracle's own features."""
    oracle = get_features("oracle", FeatureOptions(episode=episode))
    library = ReferenceLibrary(backend="oracle", dimensions=oracle.dimensions)
    for category in categories:
        one_hot = np.eye(oracle.dimensions)[oracle.categories.index(category)]  # type: ignore[attr-defined]
        library = library.with_reference(
            make_reference(
                one_hot,
                IMAGE,
                category,
                episode=episode.id,
                frame=0,
                camera="left",
                pixel=(0, 0),
                by="ada",
                at="2026-01-01T00:00:00Z",
            )
        )
    library.save(path)


def test_what_was_clicked_once_is_found_everywhere(episode: Episode, tmp_path: Path) -> None:
    path, task = tmp_path / "oracle.json", get_task("pack_battery")
    write_library(path, episode, "battery", BACKGROUND)
    found = LibrarySource("oracle", path).instances(episode, task)
    true = [i for i in OracleSource().instances(episode, task) if i.category == "battery"]
    assert len(found) == len(true)
    for instance in found:
        gap = min(np.linalg.norm(instance.centroid_world - t.centroid_world) for t in true)
        assert gap < 0.005
        assert instance.category == "battery"


def test_a_library_without_the_tasks_categories_says_what_to_do(
    episode: Episode, tmp_path: Path
) -> None:
    path, task = tmp_path / "oracle.json", get_task("pack_battery")
    source = LibrarySource("oracle", path)
    with pytest.raises(LabelError, match=r"oracle\.json: no references of battery or slot yet"):
        source.instances(episode, task)
    write_library(path, episode, BACKGROUND)
    with pytest.raises(LabelError, match="press I and click some"):
        source.instances(episode, task)
