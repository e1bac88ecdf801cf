"""Laws of rotations and rigid transforms, on any values that hypothesis finds."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from codediffuser.errors import ShapeError
from codediffuser.poses import (
    apply_transform,
    invert_transform,
    look_rotation,
    make_transform,
    matrix_to_quat_wxyz,
    matrix_to_rot6d,
    pose_to_transform,
    quat_wxyz_to_matrix,
    rot6d_to_matrix,
    rotation_z,
)

EXACT = 1e-9


def vectors(size: int, limit: float = 10.0) -> st.SearchStrategy[np.ndarray]:
    return arrays(np.float64, size, elements=st.floats(-limit, limit, width=32))


@st.composite
def quaternions(draw: st.DrawFn) -> np.ndarray:
    q = draw(vectors(4, 1.0))
    assume(np.linalg.norm(q) > 0.01)
    return q


@st.composite
def transforms(draw: st.DrawFn) -> np.ndarray:
    return pose_to_transform(draw(vectors(3)), draw(quaternions()))


def is_rotation(R: np.ndarray) -> bool:
    return np.allclose(R @ R.T, np.eye(3), atol=EXACT) and np.linalg.det(R) > 0


@given(quaternions())
def test_quaternion_to_matrix_agrees_with_scipy(q: np.ndarray) -> None:
    expected = Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(quat_wxyz_to_matrix(q), expected, atol=EXACT)


@given(quaternions())
def test_quaternion_survives_the_way_through_a_matrix_up_to_sign(q: np.ndarray) -> None:
    back = matrix_to_quat_wxyz(quat_wxyz_to_matrix(q))
    unit = q / np.linalg.norm(q)
    assert back[0] >= 0
    assert abs(back @ unit) == pytest.approx(1.0, abs=EXACT)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_have_a_quaternion(axis: int) -> None:
    # w is 0 here: the reading that divides by w has nothing to divide by.
    q = np.zeros(4)
    q[1 + axis] = 1.0
    np.testing.assert_allclose(np.abs(matrix_to_quat_wxyz(quat_wxyz_to_matrix(q))), q, atol=EXACT)


@given(quaternions())
def test_rotation_6d_survives_both_ways(q: np.ndarray) -> None:
    R = quat_wxyz_to_matrix(q)
    np.testing.assert_allclose(rot6d_to_matrix(matrix_to_rot6d(R)), R, atol=EXACT)


@given(vectors(6))
def test_any_two_columns_that_are_not_parallel_make_a_rotation(columns: np.ndarray) -> None:
    a, b = columns[:3], columns[3:]
    assume(np.linalg.norm(np.cross(a, b)) > 1e-3)
    R = rot6d_to_matrix(columns)
    assert is_rotation(R)
    np.testing.assert_allclose(R[:, 0], a / np.linalg.norm(a), atol=EXACT)
    assert R[:, 1] @ b > 0


def test_rotation_6d_is_the_first_column_then_the_second() -> None:
    R = np.arange(9.0).reshape(3, 3)
    assert matrix_to_rot6d(R).tolist() == [0, 3, 6, 1, 4, 7]


@given(transforms())
def test_a_transform_times_its_inverse_is_nothing(T: np.ndarray) -> None:
    np.testing.assert_allclose(invert_transform(T) @ T, np.eye(4), atol=EXACT)
    np.testing.assert_allclose(T @ invert_transform(T), np.eye(4), atol=EXACT)


@given(transforms(), transforms(), arrays(np.float64, (5, 3), elements=st.floats(-2, 2)))
def test_moving_twice_is_moving_by_the_product(
    T_a_b: np.ndarray, T_b_c: np.ndarray, points: np.ndarray
) -> None:
    twice = apply_transform(T_a_b, apply_transform(T_b_c, points))
    np.testing.assert_allclose(apply_transform(T_a_b @ T_b_c, points), twice, atol=EXACT)


@given(vectors(3), vectors(3))
def test_a_camera_looks_where_it_is_told(look: np.ndarray, right: np.ndarray) -> None:
    assume(np.linalg.norm(np.cross(look, right)) > 1e-2)
    assume(min(np.linalg.norm(look), np.linalg.norm(right)) > 1e-2)
    R_world_camera = look_rotation(look, right)
    assert is_rotation(R_world_camera)
    np.testing.assert_allclose(R_world_camera[:, 2], look / np.linalg.norm(look), atol=EXACT)
    assert R_world_camera[:, 0] @ right > 0


def test_a_level_camera_that_looks_along_y_has_its_y_axis_down() -> None:
    R_world_camera = look_rotation(np.array([0.0, 1, 0]), np.array([1.0, 0, 0]))
    np.testing.assert_allclose(R_world_camera[:, 1], [0, 0, -1], atol=EXACT)


def test_rotation_about_z_is_counter_clockwise_from_above() -> None:
    np.testing.assert_allclose(rotation_z(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=EXACT)


def test_batches_equal_their_items() -> None:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(4, 5, 4))
    R = quat_wxyz_to_matrix(q)
    T = make_transform(R, rng.normal(size=(4, 5, 3)))
    assert R.shape == (4, 5, 3, 3)
    assert T.shape == (4, 5, 4, 4)
    for name, whole, single in (
        ("matrix", R, quat_wxyz_to_matrix(q[2, 3])),
        ("quat", matrix_to_quat_wxyz(R), matrix_to_quat_wxyz(R[2, 3])),
        ("rot6d", rot6d_to_matrix(matrix_to_rot6d(R)), R[2, 3]),
        ("inverse", invert_transform(T), invert_transform(T[2, 3])),
    ):
        np.testing.assert_allclose(whole[2, 3], single, atol=EXACT, err_msg=name)


def test_points_keep_their_dtype() -> None:
    T = pose_to_transform(np.array([1.0, 2, 3]), np.array([1.0, 0, 0, 0]))
    moved = apply_transform(T, np.zeros((2, 3), dtype=np.float32))
    assert moved.dtype == np.float32
    assert moved.tolist() == [[1, 2, 3], [1, 2, 3]]
    assert apply_transform(T, np.zeros((0, 3), dtype=np.float32)).shape == (0, 3)


def test_a_quaternion_without_length_is_refused() -> None:
    with pytest.raises(ShapeError, match="zero length"):
        quat_wxyz_to_matrix(np.zeros(4))


@pytest.mark.parametrize("columns", [np.zeros(6), np.array([1.0, 2, 3, 2, 4, 6])])
def test_parallel_columns_are_refused(columns: np.ndarray) -> None:
    with pytest.raises(ShapeError, match="not parallel"):
        rot6d_to_matrix(columns)


@pytest.mark.parametrize(
    ("function", "wrong"),
    [
        (quat_wxyz_to_matrix, np.zeros(3)),
        (matrix_to_quat_wxyz, np.zeros((4, 4))),
        (rot6d_to_matrix, np.zeros(5)),
    ],
)
def test_a_wrong_shape_is_refused_with_what_came(
    function: Callable[[np.ndarray], np.ndarray], wrong: np.ndarray
) -> None:
    with pytest.raises(ShapeError, match=re.escape(str(wrong.shape))):
        function(wrong)
