"""A picture of what perception found: every instance in a colour of its own, in every view."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
from PIL import Image

from codediffuser.datagen.cameras import project
from codediffuser.labeling.perception.finding import FoundInstance
from codediffuser.labeling.perception.views import View

OPACITY = 0.65
GOLDEN = 0.618034
"""Of a turn: successive hues this far apart never come close."""
GREY = 0.55
"""Brightness of what is no instance, so that colours stand out."""


def found_overlay(
    views: Sequence[View], found: Sequence[FoundInstance], *, columns: int = 3
) -> Image.Image:
    """Draw the views in rows, the points of each instance over them.

    Args:
        views: At least one, of one size.
        found: From these views.
        columns: Views in a row.
    """
    tiles = [_painted(view, found) for view in views]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[k : k + columns], axis=1) for k in range(0, len(tiles), columns)]
    return Image.fromarray(np.concatenate(rows, axis=0))


def _painted(view: View, found: Sequence[FoundInstance]) -> np.ndarray:
    """One view (H, W, 3) uint8."""
    picture = view.rgb.astype(np.float32) * GREY
    for number, instance in enumerate(found):
        mask = _shown(instance.points_world, view)
        color = np.array(colorsys.hsv_to_rgb(number * GOLDEN % 1.0, 0.75, 1.0)) * 255
        picture[mask] = (1 - OPACITY) * view.rgb[mask] + OPACITY * color
    return np.rint(picture).astype(np.uint8)


def _shown(points_world: np.ndarray, view: View) -> np.ndarray:
    """Pixels (H, W) bool whose own reading is one of the points."""
    uv, z = project(points_world, view.camera.K, view.camera.T_world_camera)
    mask = np.zeros(view.depth_m.shape, dtype=bool)
    with np.errstate(invalid="ignore"):
        inside = (z > 0) & (uv > -0.5).all(axis=1)
        inside &= (uv < np.array([view.camera.width, view.camera.height]) - 0.5).all(axis=1)
    column, row = np.floor(uv[inside] + 0.5).astype(np.intp).T
    same = np.abs(view.depth_m[row, column] - z[inside]) < 1e-3
    mask[row[same], column[same]] = True
    return mask
