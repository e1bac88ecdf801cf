from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from codediffuser.labeling.perception.pose_search import (
    Model,
    best_nearby,
    explained,
    model_of,
    tilted,
)
from codediffuser.labeling.perception.views import View
from codediffuser.pointcloud import backproject_depth, farthest_point_indices
from codediffuser.poses import apply_transform, make_transform

MakeViews = Callable[..., tuple[View, ...]]
HERE = np.eye(4)


@pytest.fixture
def views(make_views: MakeViews) -> tuple[View, ...]:
    return make_views(3, 160, 120)


@pytest.fixture
def model(views: tuple[View, ...]) -> Model:
    """300 points of the box that the views show, with its colour."""
    clouds = [backproject_depth(v.depth_m, v.camera.K, v.camera.T_world_camera)[0] for v in views]
    cloud = np.concatenate(clouds)
    box = cloud[cloud[:, 2] > 0.005]
    return model_of(box[farthest_point_indices(box, 300)].astype(np.float64), views)


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return make_transform(np.eye(3), np.array([x, y, z]))


def test_points_take_the_color_that_pictures_show(views: tuple[View, ...], model: Model) -> None:
    np.testing.assert_allclose(np.nanmedian(model.rgb, axis=0), [200 / 255, 0, 0], atol=1e-6)
    nowhere = model_of(np.array([[0.0, 0.0, 0.3]]), views)
    assert np.isnan(nowhere.rgb).all()


def test_the_true_pose_is_explained_best(views: tuple[View, ...], model: Model) -> None:
    shifts = [moved(x=s) for s in (0.004, 0.01, 0.03)] + [moved(z=s) for s in (0.004, 0.02)]
    here, *elsewhere = explained(model, np.stack([HERE, *shifts]), views)
    assert here > 0.9
    assert max(elsewhere) < here - 0.02


def test_what_is_hidden_speaks_neither_for_nor_against(
    views: tuple[View, ...], model: Model
) -> None:
    under_the_table, outside = explained(model, np.stack([moved(z=-0.3), moved(x=9.0)]), views)
    assert under_the_table == pytest.approx(0.0, abs=0.02)
    assert outside == 0.0


def test_points_in_the_air_speak_against(views: tuple[View, ...], model: Model) -> None:
    assert explained(model, moved(z=0.15)[None], views)[0] < -0.5


def test_another_color_explains_less(views: tuple[View, ...], model: Model) -> None:
    green = Model(model.points, np.tile(np.array([0, 200 / 255, 0], np.float32), (300, 1)))
    unknown = Model(model.points, np.full((300, 3), np.nan, np.float32))
    as_it_is, otherwise, colorless = (
        explained(m, HERE[None], views)[0] for m in (model, green, unknown)
    )
    assert otherwise < as_it_is / 2
    assert colorless >= as_it_is


def test_a_search_finds_the_way_back(views: tuple[View, ...], model: Model) -> None:
    turn = Rotation.from_rotvec([0.05, -0.04, 0.1]).as_matrix()
    start = make_transform(turn, np.array([0.008, -0.006, 0.005]))
    off = np.linalg.norm(apply_transform(start, model.points) - model.points, axis=1).mean()
    T, value = best_nearby(model, start, views)
    left = np.linalg.norm(apply_transform(T, model.points) - model.points, axis=1).mean()
    assert left < min(0.0025, off / 4)
    assert value == pytest.approx(explained(model, T[None], views)[0])


def test_a_search_from_the_best_pose_stays(views: tuple[View, ...], model: Model) -> None:
    T, _ = best_nearby(model, HERE, views)
    assert np.linalg.norm(apply_transform(T, model.points) - model.points, axis=1).max() < 0.002


def test_tilting_leaves_the_middle_where_it_is() -> None:
    middle = np.array([0.1, 0.2, 0.3])
    poses = tilted(HERE, middle, 0.4)
    assert len(poses) == 8
    for T in poses:
        np.testing.assert_allclose(apply_transform(T, middle[None])[0], middle, atol=1e-12)
        assert T[2, 2] == pytest.approx(np.cos(0.4))
