"""Titles on spines: the same pixels every time, inside of the spine, on the body."""

from __future__ import annotations

import numpy as np
import pytest

from codediffuser.datagen.bookshelf import book_body
from codediffuser.datagen.spine import LIFT_M, PAGES_RGB, TitleStyle, book_decal, spine_image

STYLE = TitleStyle(pixels_per_m=4000, margin_m=0.01, width_share=0.6)
BLUE, YELLOW = (0.03, 0.12, 0.55), (0.85, 0.62, 0.05)
SIZE_M, BEVEL_M = (0.024, 0.13, 0.19), (0.006, 0.007)


def printed(title: str, color: tuple[float, float, float] = BLUE) -> np.ndarray:
    """Where letters are, (H, W) bool, without the strip of pages."""
    image = spine_image(title, color, 0.024, 0.19, STYLE)[:, :96].astype(int)
    return np.abs(image - image[0, 0]).sum(axis=-1) > 90


def test_the_same_title_gives_the_same_pixels() -> None:
    one, other = (spine_image("COMET", BLUE, 0.024, 0.19, STYLE) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    assert one.shape == (760, 96 + 16, 3) and one.dtype == np.uint8
    assert (one[:, 96:] == PAGES_RGB).all()


@pytest.mark.parametrize("title", ["FOX", "COMET", "A HISTORY OF THE HUNDRED LIGHTHOUSES"])
def test_a_title_keeps_the_margins_and_the_middle(title: str) -> None:
    rows, columns = np.nonzero(printed(title))
    margin_px, height_px = 40, 58
    assert rows.min() >= margin_px - 1 and rows.max() <= 760 - margin_px
    assert np.ptp(columns) <= height_px
    assert (rows.min() + rows.max()) / 2 == pytest.approx(380, abs=12)
    assert (columns.min() + columns.max()) / 2 == pytest.approx(48, abs=8)


def test_a_title_reads_downwards() -> None:
    # The bar of an L is at its foot: turned by a quarter clockwise it lies left of its stem's top.
    letters = printed("L")
    rows, columns = np.nonzero(letters)
    first_row = letters[rows.min() + 2]
    assert np.count_nonzero(first_row) > 0.8 * np.ptp(columns)
    last_row = np.nonzero(letters[rows.max() - 2])[0]
    assert last_row.max() < columns.mean() + 3


def test_ink_stands_out_from_the_cover() -> None:
    dark, light = (spine_image("COMET", c, 0.024, 0.19, STYLE)[:, :96] for c in (BLUE, YELLOW))
    assert dark.max() > 240 and light.min() < 30


def test_the_print_lies_on_the_body_and_its_uv_in_the_picture() -> None:
    decal = book_decal("COMET", BLUE, SIZE_M, BEVEL_M, STYLE)
    assert decal.uv.shape == (len(decal.mesh.vertices), 2)
    assert decal.uv.min() >= 0 and decal.uv.max() <= 1
    body = book_body(SIZE_M, BEVEL_M)
    offsets = np.einsum("ij,ij->i", body.face_normals, body.triangles[:, 0])
    beyond = (decal.mesh.vertices @ body.face_normals.T - offsets).max(axis=1)
    assert beyond.min() > 0 and beyond.max() < 2 * LIFT_M
    # Seen from the front (from -y) and from above, never from behind.
    assert (decal.mesh.face_normals[:, 1] < 0.01).all()
    assert (np.abs(decal.mesh.face_normals).max(axis=1) > 0.7).all()


def test_the_left_of_the_picture_lies_on_the_left_of_the_spine() -> None:
    decal = book_decal("COMET", BLUE, SIZE_M, BEVEL_M, STYLE)
    spine = np.abs(decal.mesh.vertices[:, 1] + 0.065) < 0.001
    left = decal.uv[spine][np.argmin(decal.mesh.vertices[spine][:, 0])]
    right = decal.uv[spine][np.argmax(decal.mesh.vertices[spine][:, 0])]
    assert left[0] < right[0]
    top = decal.uv[np.argmax(decal.mesh.vertices[:8, 2])]
    assert top[1] == 0
