"""Pads as photos, and what a PDF really holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from codediffuser.datagen.drawing import Drawing
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.sheets.pads_pdf import FOOTER_MM, MARGIN_MM, pads_pdf
from codediffuser.datagen.sheets.tags import PadSheet, pad_sheets
from codediffuser.datagen.task import Task
from codediffuser.datagen.tasks.pack_battery import PackBattery

DPI = 150


@pytest.fixture(scope="session")
def drawings(pack_battery: PackBattery, scenes: list[SceneSpec]) -> list[Drawing]:
    """Twenty reset pictures of pack_battery."""
    return [pack_battery.draw_reset(scene) for scene in scenes[:20]]


@dataclass(frozen=True)
class Print:
    """A pad as it came out of the printer, on one sheet of paper."""

    sheet: PadSheet
    rgb: np.ndarray
    H_print_world: np.ndarray
    """From metres on the table to pixels of the print."""

    def outline_m(self) -> np.ndarray:
        """Front left, front right, back right and back left corner of the sheet."""
        (x0, y0), (x1, y1) = self.sheet.low_m, self.sheet.high_m
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


@pytest.fixture(scope="session")
def printed() -> Callable[[Task, str], Print]:
    """Rasterise the pad of a variant from its A3 pads.pdf."""

    def make(task: Task, variant: str) -> Print:
        import pypdfium2

        (sheet,) = pad_sheets(task.name, variant, task.pads(variant))
        document = pypdfium2.PdfDocument(pads_pdf(task, variant, "A3"))
        assert len(document) == 1
        rgb = np.array(document[0].render(scale=DPI / 72).to_pil().convert("RGB"))
        scale = DPI / 25.4 * 1000
        # Pixel centres lie on whole numbers, so the paper's edge is at -0.5.
        left = scale * MARGIN_MM / 1000 - scale * sheet.low_m[0] - 0.5
        bottom = rgb.shape[0] - scale * (MARGIN_MM + FOOTER_MM) / 1000 + scale * sheet.low_m[1]
        H = np.array([[scale, 0, left], [0, -scale, bottom - 0.5], [0, 0, 1]])
        return Print(sheet, rgb, H)

    return make


@pytest.fixture(scope="session")
def battery_print(printed: Callable[[Task, str], Print], pack_battery: PackBattery) -> Print:
    """The pad of pack_battery, sim."""
    return printed(pack_battery, "sim")


@pytest.fixture(scope="session")
def photograph() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Take a photo of a print: perspective, blur, uneven light, noise.

    The function returns rgb (H, W, 3) uint8 and the true homography from the table to its pixels.
    """

    def take(
        page: Print, *, width: int = 1280, height: int = 960, blur_px: float = 1.0,
        noise: float = 4.0, light: tuple[float, float] = (1.0, 0.6),
        corners: Any = ((0.1, 0.92), (0.92, 0.86), (0.76, 0.2), (0.2, 0.25)),
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        import cv2

        from codediffuser.datagen.sheets.photo_overlay import project

        at = project(page.H_print_world, page.outline_m())
        where = np.array(corners) * [width, height]
        H = cv2.getPerspectiveTransform(at.astype(np.float32), where.astype(np.float32))
        # Twice as large, then averaged: a camera's pixel sees an area, not a point.
        finer = np.array([[2.0, 0, 0.5], [0, 2, 0.5], [0, 0, 1]])
        large = cv2.warpPerspective(
            page.rgb, finer @ H, (2 * width, 2 * height), borderValue=(120, 90, 60)
        )
        rgb = cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
        rgb = cv2.GaussianBlur(rgb, (0, 0), blur_px)
        rgb *= np.linspace(*light, width, dtype=np.float32)[None, :, None]
        rgb += noise * np.random.default_rng(0).standard_normal(rgb.shape, dtype=np.float32)
        return np.clip(rgb, 0, 255).astype(np.uint8), H @ page.H_print_world

    return take


@pytest.fixture(scope="session")
def battery_photo(
    battery_print: Print, photograph: Callable[..., tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """A usual photo of that pad, and its true homography."""
    return photograph(battery_print)
