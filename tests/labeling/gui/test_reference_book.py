from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codediffuser.errors import ConfigError, LabelError, SetupError
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.reference_book import ReferenceBook
from codediffuser.labeling.perception.features import FeatureOptions
from codediffuser.labeling.perception.oracle_features import OracleFeatures
from codediffuser.labeling.perception.references import classify, image_hash
from codediffuser.labeling.perception.views import stack_views, views_at


@pytest.fixture
def book(tmp_path: Path) -> ReferenceBook:
    return ReferenceBook("oracle", tmp_path / "references" / "oracle.json")


@pytest.fixture
def scene(desk: Desk) -> EpisodeScene:
    return desk.scene("000001")


def pixel_of(scene: EpisodeScene, category: str) -> tuple[str, tuple[int, int]]:
    """A camera and a pixel (column, row) that shows a category."""
    assert scene.episode is not None and scene.task is not None
    views = views_at(scene.episode)
    oracle = OracleFeatures(scene.task, scene.episode.scene, {})
    maps = oracle.maps(*stack_views(views))
    number, row, column = np.argwhere(maps[..., oracle.categories.index(category)] == 1)[0]
    return views[number].name, (int(column), int(row))


def test_a_clicked_pixel_becomes_a_reference(book: ReferenceBook, scene: EpisodeScene) -> None:
    for category in ("battery", "slot", "background"):
        camera, pixel = pixel_of(scene, category)
        library = book.add(scene, camera, pixel, category, "ada")
    assert book.read() == library
    assert library.backend == "oracle"
    assert library.categories == ("battery", "slot")
    kept = library.references[-1]
    assert (kept.episode, kept.frame, kept.camera, kept.pixel) == ("000001", 0, camera, pixel)
    assert scene.start is not None
    assert kept.image_sha256 == image_hash(scene.start.rgb[camera])
    assert [r.category for r in book.marked(scene, camera)][-1] == "background"
    # What was clicked is what is found.
    features = np.stack([r.feature for r in library.references])
    assert classify(features, library)[0].tolist() == [0, 1, -1]


def test_everybody_takes_back_their_own(book: ReferenceBook, scene: EpisodeScene) -> None:
    camera, pixel = pixel_of(scene, "battery")
    for by in ("ada", "ben"):
        book.add(scene, camera, pixel, "battery", by)
    assert book.remove_last("ada").by == "ada"
    library = book.read()
    assert library is not None
    assert [r.by for r in library.references] == ["ben"]
    with pytest.raises(LabelError, match="ada has made no reference"):
        book.remove_last("ada")


def test_two_servers_share_a_file(book: ReferenceBook, scene: EpisodeScene, tmp_path: Path) -> None:
    camera, pixel = pixel_of(scene, "battery")
    other = ReferenceBook("oracle", book.path)
    for number in range(3):
        book.add(scene, camera, pixel, "battery", f"ada{number}")
        other.add(scene, camera, pixel, "battery", f"ben{number}")
    library = book.read()
    assert library is not None
    assert len(library.references) == 6


def test_clicks_that_mean_nothing_keep_nothing(
    book: ReferenceBook, scene: EpisodeScene, desk: Desk, blind_episode: str
) -> None:
    camera = next(iter(scene.cameras))
    with pytest.raises(LabelError, match="beside the picture"):
        book.add(scene, camera, (-1, 3), "battery", "ada")
    with pytest.raises(LabelError, match="cannot be read"):
        book.add(scene, "nowhere", (3, 3), "battery", "ada")
    assert book.read() is None


def test_a_damaged_library_is_kept_and_said(book: ReferenceBook, scene: EpisodeScene) -> None:
    camera, pixel = pixel_of(scene, "battery")
    book.add(scene, camera, pixel, "battery", "ada")
    torn = book.path.read_text()[:-40]
    book.path.write_text(torn)
    with pytest.raises(ConfigError, match=r"oracle\.json"):
        book.add(scene, camera, pixel, "battery", "ada")
    assert book.path.read_text() == torn


def test_missing_weights_are_said_at_the_first_click(scene: EpisodeScene, tmp_path: Path) -> None:
    pytest.importorskip("timm")
    options = FeatureOptions(weights=tmp_path / "none.pth")
    book = ReferenceBook("dinov2", tmp_path / "references.json", options)
    with pytest.raises(SetupError, match=r"none\.pth: no such file"):
        book.add(scene, next(iter(scene.cameras)), (3, 3), "battery", "ada")
    assert book.read() is None
