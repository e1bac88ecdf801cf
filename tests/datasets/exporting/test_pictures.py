"""Pictures in text and their statistics: nothing is lost, nothing overflows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from codediffuser.datasets.exporting.pictures import (
    PixelStats,
    mask_bits,
    masks_of_bits,
    picture_of,
    pixel_stats,
    png_text,
)
from codediffuser.datasets.stats import QUANTILES, STEP, Histogram
from codediffuser.errors import DatasetError, ShapeError

SIDES = st.tuples(st.integers(1, 9), st.integers(1, 9))


@given(arrays(np.uint16, SIDES))
def test_depth_survives_text(depth: np.ndarray) -> None:
    assert np.array_equal(picture_of(png_text(depth)), depth)


@given(arrays(bool, st.tuples(st.just(2), st.integers(1, 9), st.integers(1, 9))))
def test_masks_survive_text(masks: np.ndarray) -> None:
    assert np.array_equal(masks_of_bits(picture_of(png_text(mask_bits(masks)))), masks)


@pytest.mark.parametrize("text", ["", "data:image/png;base64,", "no base64!", "aGVsbG8="])
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(DatasetError, match="not a"):
        picture_of(text)


def test_colour_is_no_depth() -> None:
    with pytest.raises(ShapeError, match=r"expected \(H, W\) uint8 or uint16"):
        png_text(np.zeros((4, 4, 3), np.uint8))


def test_statistics_of_pixels_are_those_of_all_pixels() -> None:
    pictures = np.random.default_rng(0).integers(0, 256, (5, 12, 9, 3)).astype(np.uint8)
    counted = PixelStats()
    for picture in pictures:
        counted.add(picture)
    stats, values = counted.stats(), pictures.reshape(-1, 3) / 255.0
    for name in ("min", "max", "mean", "std"):
        assert stats[name].shape == (3, 1, 1)
        assert np.allclose(stats[name].ravel(), getattr(values, name)(axis=0)), name
    for name, share in QUANTILES.items():
        expected = np.quantile(values, share, axis=0, method="inverted_cdf")
        assert np.allclose(stats[name].ravel(), expected), name
    assert stats["count"] == [5]


def test_counts_of_parts_add_up() -> None:
    rng = np.random.default_rng(1)
    parts = [rng.integers(0, 50, (3, 256)) for _ in range(2)]
    joined = pixel_stats(parts[0] + parts[1], 2)
    total = sum(parts)[0]
    assert joined["mean"][0, 0, 0] == pytest.approx((total @ np.arange(256)) / total.sum() / 255)


@given(arrays(np.float64, st.integers(1, 60), elements=st.floats(-3, 3)), st.integers(1, 59))
def test_histograms_of_parts_give_quantiles_of_the_whole(values: np.ndarray, cut: int) -> None:
    parts = [part for part in (values[:cut], values[cut:]) if len(part)]
    joined = Histogram.sum([Histogram.of(part) for part in parts])
    exact = np.quantile(values, list(QUANTILES.values()), method="inverted_cdf")
    assert np.abs(joined.quantiles() - exact).max() <= STEP / 2 + 1e-12
