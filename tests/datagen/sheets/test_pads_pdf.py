"""What is measured here is read back from the PDF's own vector operators."""

from __future__ import annotations

import ctypes
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pypdfium2
import pypdfium2.raw as raw
import pytest

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen.sheets.pads_pdf import (
    MARGIN_MM,
    OVERLAP_MM,
    PAPERS_MM,
    RULER_MM,
    Paper,
    divide,
    pads_pdf,
)
from codediffuser.datagen.sheets.tags import pad_sheets
from codediffuser.datagen.task import TASKS, Task
from codediffuser.datagen.tasks.pack_battery import PackBattery

MM_PER_POINT = 25.4 / 72
CROSS_MM = 8.0
PADS = [(name, variant) for name in TASKS.names() for variant in ("sim", "real")]


@dataclass(frozen=True)
class Measured:
    """One sheet of paper. All in mm from its lower left corner."""

    size: np.ndarray
    crosses: np.ndarray
    """(N, 2) middles."""
    strokes: np.ndarray
    """(M, 2, 2) straight strokes: start and end."""
    text: str


def measure(pdf: bytes) -> list[Measured]:
    """Read every stroke of every page, by PDFium."""
    pages = []
    for page in pypdfium2.PdfDocument(pdf):
        strokes = [
            points * MM_PER_POINT
            for item in page.get_objects(filter=[raw.FPDF_PAGEOBJ_PATH])
            if len(points := path_points(item)) == 2
        ]
        levels = [s for s in strokes if is_arm(s, 0)]
        uprights = [s for s in strokes if is_arm(s, 1)]
        crosses = [
            a.mean(axis=0)
            for a, b in itertools.product(levels, uprights)
            if np.abs(a.mean(axis=0) - b.mean(axis=0)).max() < 0.01
        ]
        size = np.array(page.get_size()) * MM_PER_POINT
        text = page.get_textpage().get_text_range()
        pages.append(Measured(size, np.array(crosses), np.array(strokes), text))
    return pages


def path_points(item: Any) -> np.ndarray:
    """(N, 2) points of a path on its page."""
    matrix = np.array(item.get_matrix().get()).reshape(3, 2)
    x, y, points = ctypes.c_float(), ctypes.c_float(), []
    for i in range(raw.FPDFPath_CountSegments(item)):
        raw.FPDFPathSegment_GetPoint(raw.FPDFPath_GetPathSegment(item, i), x, y)
        points.append((x.value, y.value, 1.0))
    return np.array(points) @ matrix


def is_arm(stroke: np.ndarray, axis: int) -> bool:
    along = np.abs(stroke[1] - stroke[0])
    return bool(abs(along[axis] - CROSS_MM) < 0.01 and along[1 - axis] < 0.01)


def inside(points: np.ndarray, low: Any, high: Any) -> np.ndarray:
    """Which points a sheet keeps; one right on a cut goes to the sheet after it."""
    return np.all((points >= np.array(low) - 0.01) & (points < np.array(high) - 0.01), axis=1)


def cut_lines(page: Measured, axis: int) -> tuple[float, float]:
    """Where a sheet of paper is cut across one axis: by strokes of 5 mm along the other."""
    along = np.abs(page.strokes[:, 1] - page.strokes[:, 0])
    marks = page.strokes[(np.abs(along[:, 1 - axis] - 5) < 0.01) & (along[:, axis] < 0.01)]
    places = np.unique(np.round(marks[:, 0, axis], 3))
    assert len(places) == 2
    return float(places[0]), float(places[1])


@pytest.mark.parametrize("paper", ["A4", "A3"])
@pytest.mark.parametrize(("name", "variant"), PADS)
def test_cut_and_joined_the_crosses_lie_as_in_the_yaml_to_a_tenth_of_a_millimetre(
    name: str, variant: str, paper: Paper
) -> None:
    task = TASKS.get(name)()
    pages = iter(measure(pads_pdf(task, variant, paper)))
    for pad in task.pads(variant):
        found: list[np.ndarray] = []
        back = 0.0
        for _ in itertools.count():
            right = 0.0
            for _ in itertools.count():
                page = next(pages)
                (x0, x1), (y0, y1) = cut_lines(page, 0), cut_lines(page, 1)
                kept = inside(page.crosses, (x0, y0), (x1, y1))
                found.extend(page.crosses[kept] - (x0, y0) + (right, back))
                right += x1 - x0
                if is_last(page, "column"):
                    break
            back += y1 - y0
            if is_last(page, "row"):
                break
        expected = 1000 * np.array(pad.crosses_m())
        assert len(found) == len(expected)
        joined = np.array(sorted(map(tuple, np.round(found, 3)), key=lambda at: (at[1], at[0])))
        distances, wanted = (
            np.linalg.norm(points[:, None] - points[None], axis=-1) for points in (joined, expected)
        )
        assert np.abs(distances - wanted).max() < 0.1


def is_last(page: Measured, what: str) -> bool:
    """By the words that a person reads: `column 1 of 2, row 1 of 1`, or nothing for one sheet."""
    if f"{what} " not in page.text:
        return True
    number, total = page.text.split(f"{what} ")[1].replace(",", " ").split()[0:3:2]
    return number == total


@pytest.mark.parametrize("paper", ["A4", "A3"])
def test_every_sheet_is_paper_with_a_ruler_of_100_mm(
    pack_battery: PackBattery, paper: Paper
) -> None:
    for page in measure(pads_pdf(pack_battery, "sim", paper)):
        assert sorted(np.round(page.size)) == sorted(PAPERS_MM[paper])
        lengths = np.linalg.norm(page.strokes[:, 1] - page.strokes[:, 0], axis=1)
        assert np.sum(np.abs(lengths - RULER_MM) < 0.01) == 1
        assert "100 mm" in page.text and "100 %" in page.text


def test_tiles_are_alike_share_a_strip_and_are_cut_in_its_middle(
    pack_battery: PackBattery,
) -> None:
    (sheet,) = pad_sheets("pack_battery", "sim", pack_battery.pads("sim"))
    left, right = measure(pads_pdf(pack_battery, "sim", "A4"))
    (start, end), (start_right, end_right) = cut_lines(left, 0), cut_lines(right, 0)
    assert start == pytest.approx(MARGIN_MM, abs=0.01)
    assert start_right == pytest.approx(MARGIN_MM + OVERLAP_MM / 2, abs=0.01)
    assert end - start == pytest.approx(end_right - start_right, abs=0.01)
    width = 1000 * (sheet.high_m[0] - sheet.low_m[0])
    assert end - start + end_right - start_right == pytest.approx(width, abs=0.01)
    assert "page 1 of 2" in left.text and "page 2 of 2" in right.text


@pytest.mark.parametrize("paper", ["A4", "A3"])
@pytest.mark.parametrize(("name", "variant"), PADS)
def test_no_cut_runs_through_a_tag(name: str, variant: str, paper: Paper) -> None:
    task = TASKS.get(name)()
    for sheet in pad_sheets(name, variant, task.pads(variant)):
        span_mm = 1000 * np.subtract(sheet.high_m, sheet.low_m)
        for tilings in (divide(span_mm, PAPERS_MM[paper]), divide(span_mm, PAPERS_MM[paper][::-1])):
            for axis, tiling in enumerate(tilings):
                cuts = [tiling.cuts(i)[0] for i in range(1, tiling.count)]
                for tag in sheet.tags:
                    at = 1000 * (tag.corners_m()[:, axis] - sheet.low_m[axis])
                    assert not any(at.min() - 2 < cut < at.max() + 2 for cut in cuts)


def test_same_pads_same_bytes_and_no_date(pack_battery: PackBattery) -> None:
    first = pads_pdf(pack_battery, "sim")
    assert first == pads_pdf(pack_battery, "sim")
    info = pypdfium2.PdfDocument(first).get_metadata_dict()
    assert info["Title"] == "pack_battery sim pads"
    assert info["CreationDate"].startswith("D:2000")


def test_viewers_are_told_not_to_scale(pack_battery: PackBattery) -> None:
    assert b"/PrintScaling /None" in pads_pdf(pack_battery, "sim")


@pytest.mark.parametrize(("name", "variant"), PADS)
def test_tags_lie_beside_the_pad_and_no_two_pads_share_one(name: str, variant: str) -> None:
    task: Task = TASKS.get(name)()
    numbers: list[int] = []
    for sheet in pad_sheets(name, variant, task.pads(variant)):
        low, high = np.array(sheet.low_m), np.array(sheet.high_m)
        for corner, tag in enumerate(sheet.tags):
            corners = tag.corners_m()
            assert tag.number % 4 == corner
            assert np.all((corners > low) & (corners < high))
            beside = (corners[:, 0] < sheet.pad.low_m[0]) | (corners[:, 0] > sheet.pad.high_m[0])
            assert beside.all()
        numbers += [tag.number for tag in sheet.tags]
    assert len(set(numbers)) == len(numbers)
