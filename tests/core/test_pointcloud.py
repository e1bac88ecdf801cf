import itertools

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from codediffuser.errors import ShapeError
from codediffuser.pointcloud import (
    backproject_depth,
    crop_box,
    farthest_point_indices,
    fuse_views,
    inside_box,
)
from codediffuser.poses import invert_transform, look_rotation, make_transform

K = np.array([[40.0, 0, 15.5], [0, 40.0, 11.5], [0, 0, 1]])
SHAPE = (24, 32)


@pytest.fixture
def T_world_camera() -> np.ndarray:
    R_world_camera = look_rotation(np.array([0.4, 0.4, -0.3]), np.array([1.0, -1, 0]))
    return make_transform(R_world_camera, np.array([-0.5, -0.5, 0.55]))


def project(points_world: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    T_camera_world = invert_transform(T_world_camera)
    camera = points_world @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    pixel = camera @ K.T
    return np.column_stack([pixel[:, :2] / pixel[:, 2:], camera[:, 2]])


def test_points_project_back_to_their_pixels_and_depths(T_world_camera: np.ndarray) -> None:
    depth_m = np.random.default_rng(0).uniform(0.3, 1.5, SHAPE).astype(np.float32)
    points_world, index = backproject_depth(depth_m, K, T_world_camera)
    assert points_world.dtype == np.float32
    assert index.tolist() == list(range(depth_m.size))
    u_v_depth = project(points_world.astype(np.float64), T_world_camera)
    v, u = np.divmod(index, SHAPE[1])
    np.testing.assert_allclose(u_v_depth, np.column_stack([u, v, depth_m.ravel()]), atol=1e-3)


def test_a_wall_across_the_axis_is_flat() -> None:
    # Depth runs along the optical axis: equal depths make a plane, not a sphere.
    points_world, _ = backproject_depth(np.full(SHAPE, 0.7, np.float32), K, np.eye(4))
    np.testing.assert_allclose(points_world[:, 2], 0.7, atol=1e-6)


def test_pixels_without_a_usable_reading_are_left_out() -> None:
    depth_m = np.full(SHAPE, 0.5, np.float32)
    unusable = {(0, 0): 0.0, (0, 1): np.nan, (1, 0): 2.01, (1, 1): -0.5, (2, 2): np.inf}
    for pixel, reading in unusable.items():
        depth_m[pixel] = reading
    points_world, index = backproject_depth(depth_m, K, np.eye(4))
    assert len(points_world) == len(index) == depth_m.size - len(unusable)
    assert not set(index.tolist()) & {v * SHAPE[1] + u for v, u in unusable}
    assert np.isfinite(points_world).all()


def test_a_view_of_nothing_gives_no_points() -> None:
    points_world, index = backproject_depth(np.zeros(SHAPE, np.float32), K, np.eye(4))
    assert points_world.shape == (0, 3) and points_world.dtype == np.float32
    assert index.shape == (0,)


def test_views_are_joined_in_their_order(T_world_camera: np.ndarray) -> None:
    near, far = np.full(SHAPE, 0.4, np.float32), np.full(SHAPE, 0.9, np.float32)
    fused = fuse_views([(near, K, T_world_camera), (far, K, np.eye(4))])
    expected = [
        backproject_depth(near, K, T_world_camera)[0],
        backproject_depth(far, K, np.eye(4))[0],
    ]
    np.testing.assert_array_equal(fused, np.concatenate(expected))


def test_no_views_give_an_empty_cloud() -> None:
    assert fuse_views([]).shape == (0, 3)


@pytest.mark.parametrize(
    ("depth_m", "intrinsics", "pose"),
    [
        (np.zeros((2, 2, 1)), K, np.eye(4)),
        (np.zeros((2, 2)), np.eye(4), np.eye(4)),
        (np.zeros((2, 2)), K, np.eye(3)),
    ],
)
def test_wrong_shapes_are_refused(
    depth_m: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray
) -> None:
    with pytest.raises(ShapeError, match="expected"):
        backproject_depth(depth_m, intrinsics, pose)


def test_the_box_is_closed() -> None:
    points = np.array([[0.0, 0, 0], [1, 1, 1], [1, 1, 1.001], [-0.001, 0, 0]])
    low_m, high_m = np.zeros(3), np.ones(3)
    assert inside_box(points, low_m, high_m).tolist() == [True, True, False, False]
    np.testing.assert_array_equal(crop_box(points, low_m, high_m), points[:2])


def test_the_box_refuses_what_is_no_cloud() -> None:
    with pytest.raises(ShapeError, match=r"\(N, 3\) of floats, got \(4, 2\)"):
        inside_box(np.zeros((4, 2)), np.zeros(3), np.ones(3))
    with pytest.raises(ShapeError, match="int64"):
        inside_box(np.zeros((4, 3), dtype=np.int64), np.zeros(3), np.ones(3))


@example(2, 1, 0)  # fewer points than the buckets of a large cloud
@example(7, 3, 0)
@given(st.integers(0, 300), st.integers(0, 64), st.integers(0, 2**31))
def test_sampling_chooses_as_many_different_points_as_there_are(
    n: int, count: int, seed: int
) -> None:
    points = np.random.default_rng(seed).normal(size=(n, 3)).astype(np.float32)
    chosen = farthest_point_indices(points, count)
    assert chosen.dtype == np.int64
    assert len(set(chosen.tolist())) == len(chosen) == min(n, count)
    assert all(0 <= i < n for i in chosen)


@pytest.mark.parametrize("n", [500, 5_000, 30_000])
def test_sampling_is_that_of_the_definition(n: int) -> None:
    # Each point is the one farthest from those before it, whatever bucket height the size picks.
    points = np.random.default_rng(1).normal(size=(n, 3)).astype(np.float32)
    chosen = farthest_point_indices(points, 24)
    distance = np.full(n, np.inf)
    for previous, following in itertools.pairwise(chosen):
        distance = np.minimum(distance, np.linalg.norm(points - points[previous], axis=1))
        assert distance[following] == pytest.approx(distance.max(), rel=1e-5)


def test_sampling_the_same_cloud_gives_the_same_points() -> None:
    points = np.random.default_rng(2).normal(size=(3000, 3)).astype(np.float32)
    first = farthest_point_indices(points, 100)
    np.testing.assert_array_equal(first, farthest_point_indices(points.astype(np.float64), 100))
