"""Shapes of the table, painted into a photo through the plane of their pad."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datagen.drawing import (
    Arrow,
    Box,
    Color,
    Cross,
    Disc,
    Line,
    Polygon,
    Shape,
    Text,
)
from codediffuser.datagen.sheets.page import CAP_HEIGHT, font_path
from codediffuser.datagen.task import Pad

TINT = 0.35
"""How much of its colour a thing lays over the photo: what lies under it stays visible."""
WIDTH_SHARE = 0.003
"""Width of outlines, of the photo's width."""
TEXT_SHARE = 0.022
"""Size of words, of the photo's width."""
SUBPIXEL_BITS = 4
CIRCLE_CORNERS = 64

Plane = tuple[Pad, np.ndarray]
"""A pad and the homography (3, 3) from world x and y in metres to pixels."""


def draw_over(rgb: np.ndarray, shapes: Sequence[Shape], planes: Sequence[Plane]) -> np.ndarray:
    """Paint outlines over a photo, and light tints where things should stand.

    Args:
        rgb: (H, W, 3) uint8; not changed.
        shapes: In world x and y.
        planes: Pads in the photo, at least one; a shape goes by the one nearest to it.

    Returns:
        (H, W, 3) uint8.
    """
    import cv2

    placed = [(shape, _to_image(planes, outline(shape))) for shape in shapes]
    tinted = rgb.copy()
    for shape, at in placed:
        if isinstance(shape, Disc | Polygon) and shape.fill is not None:
            cv2.fillPoly(tinted, [_fixed(at)], _rgb(shape.fill), cv2.LINE_AA, SUBPIXEL_BITS)
    painted = cv2.addWeighted(tinted, TINT, rgb, 1 - TINT, 0)
    width = max(1, round(WIDTH_SHARE * rgb.shape[1]))
    for shape, at in placed:
        _paint_lines(painted, shape, at, width)
    words = [(shape, at[0]) for shape, at in placed if isinstance(shape, Text) and shape.bold]
    return _write(painted, words)


def outline(shape: Shape) -> np.ndarray:
    """Points (N, 2) float64 in the shape's metres: its corners, or its rim, or its one place."""
    match shape:
        case Disc():
            turn = np.linspace(0, 2 * np.pi, CIRCLE_CORNERS, endpoint=False)
            circle = np.column_stack([np.cos(turn), np.sin(turn)])
            return np.asarray(shape.center_m + shape.radius_m * circle)
        case Box():
            (left, front), (right, back) = shape.low_m, shape.high_m
            return np.array([(left, front), (right, front), (right, back), (left, back)])
        case Polygon():
            return np.array(shape.corners_m)
        case Line() | Arrow():
            return np.array([shape.start_m, shape.end_m])
        case Cross():
            (x, y), half = shape.center_m, shape.size_m / 2
            return np.array([(x - half, y), (x + half, y), (x, y - half), (x, y + half)])
        case Text():
            return np.array([shape.at_m])


def project(H: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 2) through a homography (3, 3), to (N, 2)."""
    lifted = np.column_stack([points, np.ones(len(points))]) @ H.T
    return np.asarray(lifted[:, :2] / lifted[:, 2:])


def _to_image(planes: Sequence[Plane], points: np.ndarray) -> np.ndarray:
    """Points by the plane of the pad that they lie on, or nearest to."""
    middle = points.mean(axis=0)

    def distance(plane: Plane) -> float:
        inside = np.clip(middle, plane[0].low_m, plane[0].high_m)
        return float(np.linalg.norm(middle - inside))

    return project(min(planes, key=distance)[1], points)


def _paint_lines(rgb: np.ndarray, shape: Shape, at: np.ndarray, width: int) -> None:
    import cv2

    def stroke(points: np.ndarray, color: Color, closed: bool, thickness: int) -> None:
        cv2.polylines(
            rgb, [_fixed(points)], closed, _rgb(color), thickness, cv2.LINE_AA, SUBPIXEL_BITS
        )

    match shape:
        case Disc():
            stroke(at, shape.edge, True, width)
        case Box() | Polygon():
            stroke(at, shape.edge or shape.fill or "#ffffff", True, max(1, width // 2))
        case Line():
            stroke(at, shape.color, False, width)
        case Cross():
            stroke(at[:2], shape.color, False, max(1, width // 2))
            stroke(at[2:], shape.color, False, max(1, width // 2))
        case Arrow():
            length = max(float(np.linalg.norm(at[1] - at[0])), 1.0)
            (start, end), tip = _fixed(at), 8 * width / length
            cv2.arrowedLine(
                rgb, start, end, _rgb(shape.color), width, cv2.LINE_AA, SUBPIXEL_BITS, tip
            )


def _write(rgb: np.ndarray, words: Sequence[tuple[Text, np.ndarray]]) -> np.ndarray:
    """Write what matters, edged in white; numbers and titles stand on the real things."""
    from PIL import Image, ImageDraw, ImageFont

    photo = Image.fromarray(rgb)
    pen, size = ImageDraw.Draw(photo), max(9.0, TEXT_SHARE * photo.width)
    font = ImageFont.truetype(font_path(True), size, layout_engine=ImageFont.Layout.BASIC)
    for text, (x, y) in words:
        dark = "#000000" if text.color.lower() == "#ffffff" else text.color
        pen.text(
            (x, y + size * CAP_HEIGHT / 2), text.text, fill=dark, font=font, anchor="ms",
            stroke_width=size / 9, stroke_fill="#ffffff",
        )  # fmt: skip
    return np.array(photo)


def _fixed(points: np.ndarray) -> np.ndarray:
    """Pixels as OpenCV's fixed-point integers, far away ones held within their range."""
    return np.clip(np.round(points * (1 << SUBPIXEL_BITS)), -(2**27), 2**27).astype(np.int32)


def _rgb(color: Color) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
