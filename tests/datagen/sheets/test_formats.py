"""One page, three formats: pixels, SVG and PDF show the same marks at the same places."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable

import numpy as np
import pypdfium2
import pytest

from codediffuser.datagen.drawing import Drawing
from codediffuser.datagen.sheets.layout import lay_out, wrap
from codediffuser.datagen.sheets.page import Outline, Page, Round, Words, box, text_width
from codediffuser.datagen.sheets.pdf import Placed, Sheet, pdf_bytes
from codediffuser.datagen.sheets.raster import png_bytes, render
from codediffuser.datagen.sheets.svg import svg_bytes

SVG = "{http://www.w3.org/2000/svg}"
DPI = 144


def by_raster(page: Page) -> np.ndarray:
    return np.array(render(page, DPI))


def sheet_of(page: Page) -> Sheet:
    """A sheet as large as the page that it shows."""
    return Sheet(page.width, page.height, (Placed(page, 0, 0),))


def by_pdf(page: Page) -> np.ndarray:
    document = pypdfium2.PdfDocument(pdf_bytes([sheet_of(page)], "page"))
    return np.array(document[0].render(scale=DPI / 72).to_pil().convert("RGB"))


@pytest.fixture
def page() -> Page:
    return Page(
        200, 120,
        (
            box((10, 10), (60, 40), fill="#ff0000"),
            Round((120, 30), 20, fill="#00ff00", stroke="#004400", width=2),
            Outline(((20, 60), (70, 60), (70, 110), (70, 110)), True, fill="#0000ff"),
            Words((140, 90), "TITLE", 20, "#000000", bold=True),
        ),
    )  # fmt: skip


@pytest.mark.parametrize("paint", [by_raster, by_pdf])
def test_marks_lie_where_they_should_with_y_up(
    page: Page, paint: Callable[[Page], np.ndarray]
) -> None:
    rgb = paint(page)
    assert rgb.shape[:2] == (240, 400)

    def at(x: float, y: float) -> list[int]:
        return rgb[round(240 - 2 * y), round(2 * x)].tolist()

    assert at(35, 25) == [255, 0, 0] and at(5, 25) == [255, 255, 255]
    assert at(120, 30) == [0, 255, 0]
    # A corner that is named twice makes a triangle, not its bounding box.
    assert at(65, 75) == [0, 0, 255] and at(25, 105) == [255, 255, 255]


def test_pixels_and_pdf_agree_but_for_edges(page: Page) -> None:
    difference = np.abs(by_raster(page).astype(int) - by_pdf(page)).max(axis=-1)
    assert np.mean(difference > 64) < 0.01


def test_areas_are_right_to_a_part_of_a_pixel() -> None:
    radius = 20.3
    disc = by_raster(Page(60, 60, (Round((30.2, 29.7), radius, fill="#000000"),)))
    covered = np.sum(1 - disc[..., 0] / 255) / 4
    assert covered == pytest.approx(math.pi * radius**2, rel=0.02)
    turned = Outline(((10, 30), (30, 10), (50, 30), (30, 50)), True, fill="#000000")
    covered = np.sum(1 - by_raster(Page(60, 60, (turned,)))[..., 0] / 255) / 4
    assert covered == pytest.approx(800, rel=0.02)


@pytest.mark.parametrize("rotation_rad", [0.0, math.pi / 2, -math.pi / 2, 0.3])
def test_words_stand_around_their_point_at_any_angle(rotation_rad: float) -> None:
    word = Words((60, 60), "HHHHHH", 14, "#000000", rotation_rad=rotation_rad)
    dark = 255 - by_raster(Page(120, 120, (word,)))[..., 0].astype(float)
    rows, columns = np.indices(dark.shape)
    middle = np.array([(dark * columns).sum(), (dark * rows).sum()]) / dark.sum()
    np.testing.assert_allclose(middle, [119.5, 119.5], atol=1.5)
    spread = [np.sqrt((dark * (axis - 119.5) ** 2).sum() / dark.sum()) for axis in (columns, rows)]
    wide = abs(math.cos(rotation_rad)) > abs(math.sin(rotation_rad))
    assert (spread[0] > spread[1]) == wide


def test_svg_holds_the_same_marks_and_is_well_formed(page: Page) -> None:
    root = ElementTree.fromstring(svg_bytes(page))
    assert root.get("viewBox") == "0 0 200 120"
    circle = root.find(f"{SVG}circle")
    assert circle is not None and (circle.get("cx"), circle.get("cy")) == ("120", "90")
    assert [text.text for text in root.iter(f"{SVG}text")] == ["TITLE"]


def test_svg_escapes_what_titles_may_hold() -> None:
    title = 'War & Peace <"2">'
    root = ElementTree.fromstring(svg_bytes(Page(9, 9, (Words((0, 0), title, 8, "#000000"),))))
    assert [text.text for text in root.iter(f"{SVG}text")] == [title]


def test_every_format_repeats_its_bytes_and_carries_no_date(drawings: list[Drawing]) -> None:
    page = lay_out(drawings[0])
    assert png_bytes(render(page, DPI)) == png_bytes(render(page, DPI))
    assert svg_bytes(page) == svg_bytes(lay_out(drawings[0]))
    first = pdf_bytes([sheet_of(page)], "one")
    assert first == pdf_bytes([sheet_of(page)], "one")
    assert b"D:20000101" in first


def test_a_placed_page_is_scaled_moved_and_clipped(page: Page) -> None:
    sheet = Sheet(200, 120, (Placed(page, 100, 20, 0.5, clip=(0, 0, 200, 30)),))
    document = pypdfium2.PdfDocument(pdf_bytes([sheet], "placed"))
    rgb = np.array(document[0].render(scale=1).to_pil().convert("RGB"))
    assert rgb[120 - 27, 115].tolist() == [255, 0, 0]
    assert rgb[120 - 35, 115].tolist() == [255, 255, 255]


def test_sentences_break_into_lines_that_fit() -> None:
    text = "Put the left-most battery outside the crate into the furthest slot, please. " * 3
    lines = wrap(text, 10.5, 372)
    assert " ".join(lines) == text.strip()
    assert all(text_width(line, 10.5, False) <= 372 for line in lines) and len(lines) > 2
    assert wrap("unbreakable" * 20, 10.5, 50) == ["unbreakable" * 20]
    assert wrap("", 10.5, 50) == []
