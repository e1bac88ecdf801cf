from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import get_task
from codediffuser.errors import EpisodeError, NotRegisteredError, ShapeError
from codediffuser.labeling.perception.features import (
    FeatureOptions,
    get_features,
    point_features,
    sample_map,
)
from codediffuser.labeling.perception.oracle_features import OracleFeatures
from codediffuser.labeling.perception.views import View, stack_views, views_at
from codediffuser.pointcloud import backproject_depth

MakeViews = Callable[..., tuple[View, ...]]


def test_an_unknown_backend_is_answered_with_the_closest() -> None:
    with pytest.raises(NotRegisteredError, match="Did you mean 'oracle'"):
        get_features("orcale")


def test_a_map_as_large_as_the_picture_is_read_exactly() -> None:
    feature_map = np.random.default_rng(0).normal(size=(6, 8, 3)).astype(np.float32)
    uv = np.stack(np.meshgrid(np.arange(8), np.arange(6)), axis=-1).reshape(-1, 2)
    np.testing.assert_array_equal(sample_map(feature_map, uv, (6, 8)).reshape(6, 8, 3), feature_map)


def test_a_coarse_map_is_read_between_the_centres_of_its_cells() -> None:
    # Features that are the pixel coordinates of the cells' centres: looking one up gives it back.
    cells = np.stack(
        np.meshgrid((np.arange(8) + 0.5) * 10 - 0.5, (np.arange(6) + 0.5) * 10 - 0.5), -1
    )
    uv = np.random.default_rng(0).uniform(5, 54, size=(50, 2))
    np.testing.assert_allclose(sample_map(cells.astype(np.float32), uv, (60, 80)), uv, atol=1e-4)
    corner = sample_map(cells.astype(np.float32), np.array([[0.0, 0.0]]), (60, 80))
    np.testing.assert_allclose(corner, [[4.5, 4.5]])


def test_a_point_takes_its_feature_from_the_cameras_that_see_it(make_views: MakeViews) -> None:
    views = make_views(2)
    # Each camera's own number as its feature.
    maps = np.stack([np.full((60, 80, 1), k + 1, np.float32) for k in range(2)])
    points, _ = zip(
        *(backproject_depth(v.depth_m, v.camera.K, v.camera.T_world_camera) for v in views),
        strict=True,
    )
    top = np.array([[0.0, 0.0, 0.08]], np.float32)
    side = np.array([[0.05, 0.0, 0.04]], np.float32)  # of the box, towards the first camera
    inside = np.array([[0.0, 0.0, 0.04]], np.float32)
    away = np.array([[0.0, 0.0, 3.0]], np.float32)
    features, seen_by = point_features(np.concatenate([top, side, inside, away]), maps, views)
    assert seen_by.tolist() == [2, 1, 0, 0]
    assert features[:, 0].tolist() == [1.5, 1.0, 0.0, 0.0]
    own, seen_by = point_features(points[1], maps, views)
    assert (seen_by >= 1).all()
    assert (own[seen_by == 1] == 2.0).all()


def test_missing_readings_show_nothing(make_views: MakeViews) -> None:
    (view,) = make_views(1)
    blind = View("blind", view.rgb, np.full_like(view.depth_m, np.nan), view.camera)
    points, _ = backproject_depth(view.depth_m, view.camera.K, view.camera.T_world_camera)
    _, seen_by = point_features(points, np.ones((1, 6, 8, 2), np.float32), [blind])
    assert not seen_by.any()


def test_no_points_give_no_features(make_views: MakeViews) -> None:
    maps = np.ones((1, 6, 8, 2), np.float32)
    features, seen_by = point_features(np.zeros((0, 3), np.float32), maps, make_views(1))
    assert features.shape == (0, 2)
    assert seen_by.shape == (0,)


def test_maps_must_be_as_many_as_views(make_views: MakeViews) -> None:
    with pytest.raises(ShapeError, match=r"expected shape \(2, h, w, D\), got \(3, 6, 8, 1\)"):
        point_features(
            np.zeros((1, 3), np.float32), np.zeros((3, 6, 8, 1), np.float32), make_views(2)
        )


def test_the_oracle_knows_what_every_pixel_shows(
    write_battery_episode: Callable[..., Path], small_scene: SceneSpec, tmp_path: Path
) -> None:
    episode = Episode.open(write_battery_episode(tmp_path))
    views = views_at(episode)
    images, depth_m, cameras = stack_views(views)
    oracle = get_features("oracle", FeatureOptions(episode=episode))
    assert isinstance(oracle, OracleFeatures)
    maps = oracle.maps(images, depth_m, cameras)
    assert maps.shape == (*depth_m.shape, oracle.dimensions)
    assert set(np.unique(maps)) == {0.0, 1.0}
    np.testing.assert_array_equal(maps.sum(axis=-1), 1)
    assert maps[..., 0][depth_m == 0].all()
    ids = oracle.id_maps(images, depth_m, cameras)
    battery = maps[..., oracle.categories.index("battery")] == 1
    seen = {oracle.ids()[n - 1] for n in np.unique(ids[battery])}
    assert seen and seen <= {o.id for o in small_scene.objects if o.category == "battery"}


def test_the_oracle_follows_what_moves(
    write_battery_episode: Callable[..., Path], tmp_path: Path
) -> None:
    episode = Episode.open(write_battery_episode(tmp_path))
    last = episode.num_frames - 1
    images, depth_m, cameras = stack_views(views_at(episode, last))
    now = get_features("oracle", FeatureOptions(episode=episode, frame=last))
    then = get_features("oracle", FeatureOptions(episode=episode, frame=0))
    battery = now.categories.index("battery")  # type: ignore[attr-defined]
    found = [b.maps(images, depth_m, cameras)[..., battery].sum() for b in (now, then)]
    assert found[0] > found[1]


def test_the_oracle_needs_a_simulated_episode_depth_and_cameras(small_scene: SceneSpec) -> None:
    with pytest.raises(EpisodeError, match="reads a simulated episode"):
        get_features("oracle")
    oracle = OracleFeatures(get_task("pack_battery"), small_scene, {})
    with pytest.raises(ShapeError, match="needs depth_m and cameras"):
        oracle.maps(np.zeros((1, 6, 8, 3), np.uint8))
