"""Spoiled pictures: reproducible, honest about missing readings, worse with distance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from codediffuser.datagen.appearance import SensorErrors
from codediffuser.datagen.scene import SeedKey
from codediffuser.datagen.sensor_errors import depth_edges, sensor_rng, spoil_color, spoil_depth

SEED = SeedKey(root=0, stage="SCENE", index=5, attempt=0)
RGB = np.full((48, 64, 3), 100, dtype=np.uint8)


def errors(**changes: Any) -> SensorErrors:
    none: dict[str, Any] = {
        "depth_base_m": 0, "depth_per_m": 0, "drop_probability": 0, "edge_drop_probability": 0,
        "holes": 0, "hole_radius": 0.1, "color_noise": 0, "color_gain": (1, 1, 1),
    }  # fmt: skip
    return SensorErrors(**{**none, **changes})


def rng(frame: int = 0, camera: int = 0) -> np.random.Generator:
    return sensor_rng(SEED, frame, camera)


def flat(depth_m: float) -> np.ndarray:
    return np.full((48, 64), depth_m, dtype=np.float32)


def test_a_perfect_sensor_changes_nothing() -> None:
    np.testing.assert_array_equal(spoil_color(RGB, errors(), rng()), RGB)
    np.testing.assert_array_equal(spoil_depth(flat(0.7), errors(), rng()), flat(0.7))


def test_the_same_address_spoils_the_same_way_and_no_two_pictures_share_numbers() -> None:
    noisy = errors(depth_base_m=0.01)
    first = spoil_depth(flat(1), noisy, rng(3, 1))
    np.testing.assert_array_equal(first, spoil_depth(flat(1), noisy, rng(3, 1)))
    for other in (rng(4, 1), rng(3, 2)):
        assert not np.array_equal(first, spoil_depth(flat(1), noisy, other))


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 2.0])
def test_noise_grows_with_the_square_of_the_distance(depth_m: float) -> None:
    spread = spoil_depth(flat(depth_m), errors(depth_per_m=0.01), rng()).std()
    assert spread == pytest.approx(0.01 * depth_m**2, rel=0.1)


def test_pixels_without_reading_get_none() -> None:
    depth = flat(1.0)
    depth[:10] = 0
    spoiled = spoil_depth(depth, errors(depth_base_m=0.05), rng())
    assert not spoiled[:10].any() and spoiled[10:].all()


def test_dropped_readings_are_as_many_as_asked() -> None:
    spoiled = spoil_depth(flat(1.0), errors(drop_probability=0.2), rng())
    assert (spoiled == 0).mean() == pytest.approx(0.2, abs=0.03)


def test_edges_drop_at_their_own_rate() -> None:
    depth = flat(1.0)
    depth[:, 32:] = 0.5
    assert depth_edges(depth).any(axis=0).nonzero()[0].tolist() == [31, 32]
    spoiled = spoil_depth(depth, errors(edge_drop_probability=1.0), rng())
    assert (spoiled == 0).any(axis=0).nonzero()[0].tolist() == [31, 32]


def test_a_hole_has_its_radius() -> None:
    spoiled = spoil_depth(flat(1.0), errors(holes=1, hole_radius=0.25), rng(2))
    area = np.pi * (0.25 * 48) ** 2
    # A part of it may lie outside the picture.
    assert 0.2 * area < (spoiled == 0).sum() <= 1.05 * area


def test_gain_and_noise_of_colour() -> None:
    bright = spoil_color(RGB, errors(color_gain=(1.1, 1.0, 0.9)), rng())
    assert bright[0, 0].tolist() == [110, 100, 90]
    noisy = spoil_color(RGB, errors(color_noise=5.0), rng())
    assert noisy.std() == pytest.approx(5.0, rel=0.1)
    assert noisy.dtype == np.uint8
