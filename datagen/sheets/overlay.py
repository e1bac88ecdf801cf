"""`overlay.png`: all configurations of a set on one picture, as in Fig. 5 of the supplement."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.drawing import Arrow, Drawing, Panel, Shape, Text
from codediffuser.datagen.sheets.layout import Layout, lay_out, place_panels, shape_marks
from codediffuser.datagen.sheets.raster import Painter, pixels, png_bytes, render
from codediffuser.errors import ConfigError

if TYPE_CHECKING:
    from PIL.Image import Image

DPI = 110
DENSEST = 0.9
"""Opacity of the spots that are covered most often; the others follow by the square root, so that
rare places show beside slots that are taken in every second scene."""
BUSY_PERCENTILE = 99.5
"""Which coverage counts as the densest, so that few pixels do not decide for all."""


def overlay_png(drawings: Sequence[Drawing], what: tuple[str, ...]) -> bytes:
    """Lay the reset pictures of a set over each other.

    What is the same in all of them is drawn once; things that differ are laid over it, the denser
    the more often they lie there. Words and arrows that differ are left out.

    Args:
        drawings: At least one, all of one task and variant.
        what: Notes beside the title: task, variant.

    Raises:
        ConfigError: There is nothing to draw, or the drawings do not have the same panels.
    """
    if not drawings:
        raise ConfigError("expected at least one scene to draw an overlay of, got none")
    count = len(drawings[0].panels)
    if any(len(drawing.panels) != count for drawing in drawings):
        raise ConfigError("an overlay needs scenes of one task, got pictures of several kinds")
    columns = [[drawing.panels[k] for drawing in drawings] for k in range(count)]
    fixed = [_fixed_shapes(panels) for panels in columns]
    base = Drawing(
        title=f"{len(drawings)} configurations",
        notes=what,
        sentence="All initial configurations of the set. The denser, the more often.",
        panels=tuple(_common(panels, own) for panels, own in zip(columns, fixed, strict=True)),
    )
    layout = place_panels(base)
    under = np.asarray(render(lay_out(base), DPI), dtype=np.float32)
    layers = (_layer(layout, drawing.panels, fixed) for drawing in drawings)
    return png_bytes(_image(_blend(under, layers)))


def _fixed_shapes(panels: Sequence[Panel]) -> frozenset[Shape]:
    """Shapes that every one of the panels has."""
    counts = Counter(shape for panel in panels for shape in set(panel.shapes))
    return frozenset(shape for shape, count in counts.items() if count == len(panels))


def _common(panels: Sequence[Panel], fixed: frozenset[Shape]) -> Panel:
    """The first panel with the shapes of all alone, as large as the largest."""
    return replace(
        panels[0],
        low_m=(min(p.low_m[0] for p in panels), min(p.low_m[1] for p in panels)),
        high_m=(max(p.high_m[0] for p in panels), max(p.high_m[1] for p in panels)),
        shapes=tuple(shape for shape in panels[0].shapes if shape in fixed),
    )


def _layer(layout: Layout, panels: Sequence[Panel], fixed: Sequence[frozenset[Shape]]) -> Image:
    """What one drawing adds: RGBA with colours already multiplied by alpha."""
    from PIL import Image

    # Pillow's `paste` mixes all four channels alike: over clear black it leaves just such colours.
    size = (pixels(layout.width, DPI), pixels(layout.height, DPI))
    painter = Painter(Image.new("RGBA", size), DPI / 72, layout.height)
    for placed, panel, common in zip(layout.panels, panels, fixed, strict=True):
        for shape in panel.shapes:
            if shape in common or isinstance(shape, Text | Arrow):
                continue
            for mark in shape_marks(shape, placed.to_page, placed.scale):
                painter.paint(mark)
    return painter.image


def _blend(under: np.ndarray, layers: Iterable[Image]) -> np.ndarray:
    """Mean colour of what covers each pixel, over `under`, by how often it is covered.

    Args:
        under: (H, W, 3) float32 in [0, 255].
        layers: RGBA of the same size, colours multiplied by alpha.
    """
    total = np.zeros((*under.shape[:2], 4), dtype=np.uint32)
    for layer in layers:
        window = layer.getbbox()
        if window is not None:
            left, top, right, bottom = window
            total[top:bottom, left:right] += np.asarray(layer.crop(window))
    coverage = total[..., 3:].astype(np.float32)
    busy = coverage[coverage > 0]
    if not len(busy):
        return under
    color = total[..., :3] / np.maximum(coverage, 1) * 255
    share = np.minimum(coverage / np.percentile(busy, BUSY_PERCENTILE), 1.0)
    opacity = DENSEST * np.sqrt(share)
    return under + opacity * (color - under)


def _image(rgb: np.ndarray) -> Image:
    from PIL import Image

    return Image.fromarray(np.clip(np.rint(rgb), 0, 255).astype(np.uint8))
