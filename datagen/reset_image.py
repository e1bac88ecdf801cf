"""PNG of a `Drawing`: the picture by which an operator resets the scene."""

from __future__ import annotations

import io
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from codediffuser.datagen.drawing import (
    FAINT,
    INK,
    Arrow,
    Box,
    Cross,
    Disc,
    Drawing,
    Line,
    Panel,
    Polygon,
    Shape,
    Text,
)
from codediffuser.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_IN, WIDE_IN, DPI = 6.0, 11.0, 140
"""A page with one view, and one with several."""
MARGIN_IN = 0.42
HEADER_IN, LINE_IN = 0.52, 0.22
WRAP_CHARACTERS = 66
STYLE = {"font.family": "DejaVu Sans", "svg.hashsalt": "", "text.usetex": False}
"""The font that ships with matplotlib, so that pictures are alike on every machine."""


def render_png(drawing: Drawing) -> bytes:
    """Paint a drawing; the same drawing gives the same bytes with the same matplotlib."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lines = textwrap.wrap(drawing.sentence, WRAP_CHARACTERS)
    header = HEADER_IN + LINE_IN * len(lines)
    spans = [np.subtract(panel.high_m, panel.low_m) for panel in drawing.panels]
    page_width = WIDTH_IN if len(spans) == 1 else WIDE_IN
    free = page_width - 2 * MARGIN_IN * len(spans)
    in_per_m = free / sum(float(span[0]) for span in spans)
    height = in_per_m * max(float(span[1]) for span in spans)
    total = header + height + 2 * MARGIN_IN
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(page_width, total), dpi=DPI, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        left = 0.0
        for panel, span in zip(drawing.panels, spans, strict=True):
            width_in, height_in = (float(v) for v in span * in_per_m)
            frame = (left + MARGIN_IN, total - header - MARGIN_IN - height_in, width_in, height_in)
            _paint_panel(figure, panel, frame, (page_width, total))
            left += width_in + 2 * MARGIN_IN
        _write_header(figure, drawing, lines, (page_width, total))
        stream = io.BytesIO()
        canvas.print_png(stream, metadata={"Software": None})
    return stream.getvalue()


def save_png(drawing: Drawing, path: Path) -> None:
    """Write the picture whole or not at all."""
    write_bytes(path, render_png(drawing))


def _paint_panel(
    figure: Any, panel: Panel, frame_in: tuple[float, ...], page_in: tuple[float, float]
) -> None:
    page = np.array([*page_in, *page_in])
    axes = figure.add_axes(tuple(np.array(frame_in) / page))
    axes.set_xlim(panel.low_m[0], panel.high_m[0])
    axes.set_ylim(panel.low_m[1], panel.high_m[1])
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_edgecolor("#d4d8dd")
    for order, shape in enumerate(panel.shapes):
        _paint(axes, shape, order)
    _write_sides(figure, panel, frame_in, page_in)


def _paint(axes: Axes, shape: Shape, order: int) -> None:
    from matplotlib.patches import Circle, FancyArrowPatch, Rectangle
    from matplotlib.patches import Polygon as PolygonPatch

    match shape:
        case Disc():
            axes.add_patch(
                Circle(
                    shape.center_m, shape.radius_m,
                    facecolor=shape.fill or "none", edgecolor=shape.edge, linewidth=1.6,
                    linestyle=(0, (3, 2)) if shape.dashed else "solid", zorder=order,
                )
            )  # fmt: skip
        case Box():
            size = (shape.high_m[0] - shape.low_m[0], shape.high_m[1] - shape.low_m[1])
            axes.add_patch(
                Rectangle(
                    shape.low_m, *size, facecolor=shape.fill, edgecolor=shape.edge or "none",
                    linewidth=1.0, zorder=order,
                )
            )  # fmt: skip
        case Line():
            axes.plot(
                *zip(shape.start_m, shape.end_m, strict=True),
                color=shape.color, linewidth=shape.width_pt, zorder=order,
            )  # fmt: skip
        case Polygon():
            axes.add_patch(
                PolygonPatch(
                    shape.corners_m, facecolor=shape.fill or "none",
                    edgecolor=shape.edge or "none", linewidth=shape.width_pt, zorder=order,
                )
            )  # fmt: skip
        case Cross():
            (x, y), half = shape.center_m, shape.size_m / 2
            stroke: dict[str, Any] = {"color": shape.color, "linewidth": 1.1, "zorder": order}
            axes.plot([x - half, x + half], [y, y], **stroke)
            axes.plot([x, x], [y - half, y + half], **stroke)
        case Arrow():
            axes.add_patch(
                FancyArrowPatch(
                    shape.start_m, shape.end_m, arrowstyle="-|>", mutation_scale=14,
                    connectionstyle="arc3,rad=0.15", color=shape.color, linewidth=1.6,
                    shrinkA=0, shrinkB=0, zorder=order,
                )
            )  # fmt: skip
        case Text():
            axes.text(
                *shape.at_m, shape.text, fontsize=shape.size_pt, color=shape.color,
                weight="bold" if shape.bold else "normal", ha=shape.align, va="center",
                rotation=np.degrees(shape.rotation_rad), rotation_mode="anchor", zorder=order,
            )  # fmt: skip


def _write_header(
    figure: Any, drawing: Drawing, lines: list[str], page_in: tuple[float, float]
) -> None:
    width, total = page_in
    left = MARGIN_IN / width
    top = 1 - 0.30 / total
    figure.text(left, top, drawing.title, fontsize=15, weight="bold", color=INK, va="center")
    notes = "  ·  ".join(drawing.notes)
    figure.text(1 - left, top, notes, fontsize=8.5, color=FAINT, va="center", ha="right")
    for i, line in enumerate(lines):
        y = 1 - (0.60 + LINE_IN * i) / total
        figure.text(left, y, line, fontsize=10.5, color=INK, va="center")


def _write_sides(
    figure: Any, panel: Panel, frame_in: tuple[float, ...], page_in: tuple[float, float]
) -> None:
    x, y, width, height = frame_in
    middle_x, middle_y, edge = x + width / 2, y + height / 2, MARGIN_IN / 2
    style: dict[str, Any] = {
        "fontsize": 9, "weight": "bold", "color": INK, "ha": "center", "va": "center",
    }  # fmt: skip

    def write(x_in: float, y_in: float, words: str, **more: Any) -> None:
        figure.text(x_in / page_in[0], y_in / page_in[1], words, **{**style, **more})

    sides = panel.sides
    # A dark bar stands for the robot: nobody should turn the page the wrong way round.
    bar: dict[str, Any] = {"boxstyle": "round,pad=0.45", "facecolor": INK, "edgecolor": "none"}
    robot: dict[str, Any] = {"color": "white", "bbox": bar} if sides.robot else {}
    write(middle_x, y - edge, sides.bottom, **robot)
    write(middle_x, y + height + edge / 2, sides.top)
    write(x - edge, middle_y, sides.left, rotation=90)
    write(x + width + edge, middle_y, sides.right, rotation=270)
