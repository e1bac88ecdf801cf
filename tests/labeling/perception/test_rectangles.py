from __future__ import annotations

import numpy as np
import pytest

from codediffuser.labeling.perception.rectangles import join_pieces, narrowest_rectangle, turned

LEANS = np.arange(-0.5, 0.5, 0.02)


def strip(
    width_m: float, length_m: float, *, lean_rad: float = 0.0, at: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """Points spread over a rectangle whose lower left corner is `at`."""
    flat = np.random.default_rng(0).uniform(0, [width_m, length_m], (900, 2))
    sin, cos = np.sin(lean_rad), np.cos(lean_rad)
    return flat @ np.array([[cos, -sin], [sin, cos]]) + np.array(at)


@pytest.mark.parametrize("lean_rad", [-0.31, 0.0, 0.004, 0.2])
def test_the_narrowest_rectangle_leans_as_its_points(lean_rad: float) -> None:
    points = strip(0.024, 0.19, lean_rad=lean_rad, at=(0.05, 0.0))
    found = narrowest_rectangle(points, LEANS)
    assert found.angle_rad == pytest.approx(lean_rad, abs=0.01)
    width_m, length_m = found.size_m
    assert width_m == pytest.approx(0.024, abs=0.001)
    assert 0.183 < length_m <= 0.19  # the ends are trimmed
    assert found.outside_m(points).max() < 0.004


def test_strays_do_not_widen_a_rectangle() -> None:
    points = np.concatenate([strip(0.024, 0.19), [[0.1, 0.1]] * 12])
    assert narrowest_rectangle(points, LEANS).size_m[0] == pytest.approx(0.024, abs=0.003)


def test_one_point_is_a_rectangle_of_no_size() -> None:
    found = narrowest_rectangle(np.array([[0.2, 0.1]]), LEANS)
    assert found.size_m == (0.0, 0.0)
    np.testing.assert_allclose(found.outside_m(np.array([[0.2, 0.1]])), 0.0, atol=1e-12)


def test_distance_outside_is_negative_within() -> None:
    found = narrowest_rectangle(strip(0.02, 0.2), LEANS)
    inside, beside, above = found.outside_m(np.array([[0.01, 0.1], [0.05, 0.1], [0.01, 0.25]]))
    assert inside < 0
    assert beside == pytest.approx(0.03, abs=0.003)
    assert above == pytest.approx(0.05, abs=0.003)


def test_turning_keeps_distances() -> None:
    points = strip(0.02, 0.2)
    there = turned(points, 0.3)
    np.testing.assert_allclose(
        np.linalg.norm(there[0] - there[-1]), np.linalg.norm(points[0] - points[-1])
    )


def test_pieces_of_one_strip_are_joined_and_neighbours_are_not() -> None:
    left, right = strip(0.024, 0.19), strip(0.022, 0.19, at=(0.026, 0.0))
    upper, lower = left[left[:, 1] > 0.1], left[left[:, 1] <= 0.1]
    assert join_pieces([upper, right, lower], LEANS, (0.038, 0.25)) == ((0, 2), (1,))


def test_a_crumb_goes_to_the_strip_that_it_does_not_widen() -> None:
    # Either strip could take it and still be thin enough.
    thin, thick = strip(0.021, 0.19), strip(0.026, 0.19, at=(0.022, 0.0))
    crumb = strip(0.006, 0.02, at=(0.024, 0.08))
    assert join_pieces([thin, crumb, thick], LEANS, (0.038, 0.25)) == ((0,), (1, 2))


def test_pieces_farther_apart_than_a_rectangle_is_long_stay_apart() -> None:
    one, other = strip(0.02, 0.1), strip(0.02, 0.1, at=(0.0, 0.2))
    assert join_pieces([one, other], LEANS, (0.038, 0.2)) == ((0,), (1,))
    assert join_pieces([one, other], LEANS, (0.038, 0.31)) == ((0, 1),)


def test_nothing_is_joined_of_nothing() -> None:
    assert join_pieces([], LEANS, (0.038, 0.25)) == ()
