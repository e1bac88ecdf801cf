from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import SetupError, ShapeError
from codediffuser.labeling.perception.builtin import WEIGHTS, BuiltinFeatures, card_path
from codediffuser.labeling.perception.builtin_targets import (
    CATEGORIES,
    VOTE_SCALE,
    Targets,
    pixel_votes,
    voted_points,
)
from codediffuser.labeling.perception.features import get_features
from codediffuser.labeling.perception.rendered import StartScene
from codediffuser.labeling.perception.views import View, stack_views

MakeViews = Callable[..., tuple[View, ...]]


@pytest.fixture(scope="module")
def builtin() -> BuiltinFeatures:
    found = get_features("builtin")
    assert isinstance(found, BuiltinFeatures)
    return found


def test_shipped_weights_are_those_of_their_card(builtin: BuiltinFeatures) -> None:
    assert builtin.card.categories == CATEGORIES
    assert set(builtin.card.scores) == set(CATEGORIES[1:])
    assert WEIGHTS.stat().st_size < 4e6


def test_features_are_unit_vectors_as_large_as_pictures_of_training(
    builtin: BuiltinFeatures, make_views: MakeViews
) -> None:
    images, depth_m, cameras = stack_views(make_views(2, 320, 240))
    perceived = builtin.perceive(images, depth_m, cameras)
    assert perceived.maps.shape == (2, 240, 320, builtin.dimensions)
    assert perceived.middles_world.shape == (2, 240, 320, 3)
    np.testing.assert_allclose(np.linalg.norm(perceived.maps, axis=-1), 1, atol=1e-4)


def test_smaller_pictures_are_enlarged_to_what_it_knows(
    builtin: BuiltinFeatures, make_views: MakeViews
) -> None:
    maps = builtin.maps(*stack_views(make_views(1, 160, 120)))
    assert maps.shape[1:3] == (240, 320)


def test_every_category_has_a_reference_that_is_nearest_to_itself(
    builtin: BuiltinFeatures,
) -> None:
    library = builtin.library()
    features = np.stack([r.feature for r in library.references])
    cosine = features @ features.T
    np.testing.assert_array_equal(cosine.argmax(axis=1), np.arange(len(CATEGORIES)))
    assert (cosine - np.eye(len(cosine)) < library.threshold + 0.3).all()


def test_pictures_without_depth_are_refused(
    builtin: BuiltinFeatures, make_views: MakeViews
) -> None:
    images, _, cameras = stack_views(make_views(1))
    with pytest.raises(ShapeError, match="needs a depth picture and a calibrated camera"):
        builtin.maps(images, None, cameras)


def test_missing_weights_say_how_to_get_them(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="train_builtin"):
        BuiltinFeatures(tmp_path / "none.safetensors")


def test_weights_of_another_card_are_refused(tmp_path: Path) -> None:
    weights = tmp_path / "builtin.safetensors"
    weights.write_bytes(WEIGHTS.read_bytes() + b"\0")
    shutil.copy(card_path(WEIGHTS), card_path(weights))
    with pytest.raises(SetupError, match="SHA-256 differs"):
        BuiltinFeatures(weights)


def test_votes_lead_back_to_the_middle(make_views: MakeViews) -> None:
    views = make_views(3)
    middle = np.array([[0.0, 0.0, 0.04]], np.float32)
    is_box = np.stack([(v.rgb[..., 0] > 0) for v in views])
    targets = Targets(is_box.astype(np.uint8), np.array([1], np.uint8), middle)
    start = StartScene(None, {}, views, np.zeros((3, 60, 80), np.int16))  # type: ignore[arg-type]
    votes = pixel_votes(start, targets)
    assert (votes[~is_box] == 0).all()
    for view, vote, box in zip(views, votes, is_box, strict=True):
        camera: Camera = view.camera
        points = voted_points(vote, view.depth_m, camera.K, camera.T_world_camera)
        np.testing.assert_allclose(points[box], np.tile(middle, (box.sum(), 1)), atol=1e-4)
    assert np.abs(votes * VOTE_SCALE)[is_box][:, :2].max() < 80
