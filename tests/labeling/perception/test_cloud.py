from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from codediffuser.errors import EpisodeError, ShapeError
from codediffuser.labeling.perception.cloud import CloudFuser
from codediffuser.labeling.perception.depth_shape import flying_pixels, normals_camera
from codediffuser.labeling.perception.views import View, stack_views
from codediffuser.pointcloud import crop_box, fuse_views

LOW, HIGH = (-0.2, -0.2, 0.002), (0.2, 0.2, 0.3)
MakeViews = Callable[..., tuple[View, ...]]


def with_depth(view: View, depth_m: np.ndarray) -> View:
    return View(view.name, view.rgb, depth_m.astype(np.float32), view.camera)


def test_the_cloud_is_that_of_the_slow_way(make_views: MakeViews) -> None:
    views = make_views()
    cloud = CloudFuser(LOW, HIGH, drop_flying=False).fuse(views)
    slow = crop_box(
        fuse_views([(v.depth_m, v.camera.K, v.camera.T_world_camera) for v in views]),
        np.array(LOW), np.array(HIGH),
    )  # fmt: skip
    assert len(cloud) == len(slow) > 400
    np.testing.assert_allclose(cloud.points_world, slow, atol=1e-6)


def test_points_know_the_pixel_they_were_read_at(make_views: MakeViews) -> None:
    views = make_views()
    cloud = CloudFuser(LOW, HIGH).fuse(views, color=True)
    assert cloud.rgb is not None
    for point, view, pixel, rgb in list(
        zip(cloud.points_world, cloud.view, cloud.pixel, cloud.rgb, strict=True)
    )[::97]:
        camera = views[view].camera
        z = (np.linalg.inv(camera.T_world_camera) @ [*point, 1])[2]
        assert z == pytest.approx(views[view].depth_m.flat[pixel], abs=1e-5)
        assert rgb.tolist() == views[view].rgb.reshape(-1, 3)[pixel].tolist()


def test_one_fuser_serves_many_frames_and_cameras(make_views: MakeViews) -> None:
    fuser, views = CloudFuser(LOW, HIGH), make_views()
    first = fuser.fuse(views)
    nearer = [with_depth(v, v.depth_m * 0.9) for v in views]
    assert len(fuser.fuse(nearer)) != len(first)
    fuser.fuse(make_views(2, 40, 30))
    np.testing.assert_array_equal(fuser.fuse(views).points_world, first.points_world)


def test_what_is_too_near_too_far_or_missing_is_left_out(make_views: MakeViews) -> None:
    (view,) = make_views(1)
    full = CloudFuser(LOW, HIGH, drop_flying=False).fuse([view])
    depth_m = view.depth_m.copy()
    depth_m.flat[full.pixel[0]] = np.nan
    depth_m.flat[full.pixel[1]] = 0
    cloud = CloudFuser(LOW, HIGH, drop_flying=False).fuse([with_depth(view, depth_m)])
    np.testing.assert_array_equal(cloud.pixel, full.pixel[2:])
    limit = float(np.median(view.depth_m.flat[full.pixel]))
    near = CloudFuser(LOW, HIGH, max_depth_m=limit, drop_flying=False).fuse([view])
    far = CloudFuser(LOW, HIGH, min_depth_m=limit, drop_flying=False).fuse([view])
    assert 0 < len(near) < len(full)
    assert set(near.pixel.tolist()) | set(far.pixel.tolist()) == set(full.pixel.tolist())


def test_no_views_and_blind_views_give_an_empty_cloud(make_views: MakeViews) -> None:
    blind = with_depth(make_views(1)[0], np.zeros((60, 80)))
    for views in ([], [blind]):
        fuser = CloudFuser(LOW, HIGH)
        cloud = fuser.fuse(views, color=True, normals=True)
        assert len(cloud) == len(fuser.even(cloud)) == 0
        assert cloud.points_world.shape == (0, 3)
        assert cloud.points_world.dtype == np.float32


def test_even_thinning_keeps_what_belongs_together(make_views: MakeViews) -> None:
    fuser = CloudFuser(LOW, HIGH)
    cloud = fuser.fuse(make_views(), color=True, normals=True)
    even = fuser.even(cloud, 200)
    assert len(even) == 200
    where = {tuple(p): k for k, p in enumerate(cloud.points_world)}
    index = np.array([where[tuple(p)] for p in even.points_world])
    for name in ("view", "pixel", "rgb", "normals_world"):
        np.testing.assert_array_equal(getattr(even, name), getattr(cloud, name)[index])


def test_a_reading_between_two_surfaces_is_dropped_and_a_thin_wall_is_not() -> None:
    K = np.array([[250.0, 0, 20], [0, 250, 10], [0, 0, 1]])
    depth_m = np.full((20, 40), 0.8, np.float32)
    depth_m[:, 20:] = 0.6  # a clean border
    depth_m[:, 10] = 0.65  # a wall as thin as one pixel
    mixed = depth_m.copy()
    mixed[:, 20] = 0.7
    assert not flying_pixels(depth_m, K).any()
    assert np.array_equal(np.argwhere(flying_pixels(mixed, K).all(axis=0)), [[20]])
    assert np.array_equal(flying_pixels(mixed.T, K), flying_pixels(mixed, K).T)


def test_a_slanted_surface_and_missing_readings_do_not_fly() -> None:
    K = np.array([[250.0, 0, 20], [0, 250, 10], [0, 0, 1]])
    slanted = np.tile(np.linspace(0.6, 1.0, 40, dtype=np.float32), (20, 1))  # 73 degrees off
    assert not flying_pixels(slanted, K).any()
    slanted[5, 20], slanted[6, 21] = 0, np.nan
    assert not flying_pixels(slanted, K).any()


def test_normals_are_those_of_the_shapes_and_face_the_camera(make_views: MakeViews) -> None:
    views = make_views()
    cloud = CloudFuser((-0.2, -0.2, -0.01), HIGH).fuse(views, normals=True)
    normals = cloud.normals_world
    assert normals is not None
    known = np.linalg.norm(normals, axis=1) > 0
    assert known.mean() > 0.8
    np.testing.assert_allclose(np.linalg.norm(normals[known], axis=1), 1, atol=1e-5)
    # Every surface of the scene is perpendicular to an axis of the world; only at creases, where
    # neighbours lie on two surfaces, lies a normal in between.
    assert np.mean(np.abs(normals[known]).max(axis=1) > 0.999) > 0.94
    table = known & (np.abs(cloud.points_world[:, 2]) < 1e-4)
    assert np.mean(normals[table] @ [0, 0, 1] > 0.999) > 0.97
    eyes = np.array([v.camera.T_world_camera[:3, 3] for v in views])[cloud.view]
    assert (np.einsum("ij,ij->i", normals, eyes - cloud.points_world)[known] > 0).all()


def test_a_picture_too_small_for_neighbours_has_no_normals() -> None:
    assert not normals_camera(np.ones((2, 5), np.float32), np.eye(3)).any()


def test_views_must_fit_their_camera_and_each_other(make_views: MakeViews) -> None:
    (view,) = make_views(1)
    with pytest.raises(ShapeError, match=r"'camera_0': expected depth \(60, 80\)"):
        with_depth(view, np.zeros((30, 40)))
    with pytest.raises(ShapeError, match="one picture size"):
        stack_views([view, *make_views(1, 40, 30)])
    with pytest.raises(EpisodeError, match="nothing to perceive"):
        stack_views([])
