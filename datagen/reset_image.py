"""PNG of a `Drawing`: the picture by which an operator resets the scene."""

from __future__ import annotations

import io
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from codediffuser.datagen.drawing import (
    FAINT,
    INK,
    Arrow,
    Box,
    Cross,
    Disc,
    Drawing,
    Shape,
    Text,
)
from codediffuser.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_IN, DPI = 6.0, 140
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
    span_x = drawing.high_m[0] - drawing.low_m[0]
    span_y = drawing.high_m[1] - drawing.low_m[1]
    width = WIDTH_IN - 2 * MARGIN_IN
    height = width * span_y / span_x
    total = header + height + 2 * MARGIN_IN
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, total), dpi=DPI, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes(
            (MARGIN_IN / WIDTH_IN, MARGIN_IN / total, width / WIDTH_IN, height / total)
        )
        axes.set_xlim(drawing.low_m[0], drawing.high_m[0])
        axes.set_ylim(drawing.low_m[1], drawing.high_m[1])
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_edgecolor("#d4d8dd")
        for order, shape in enumerate(drawing.shapes):
            _paint(axes, shape, order)
        _write_header(figure, drawing, lines, total)
        _write_sides(figure, drawing, total, height)
        stream = io.BytesIO()
        canvas.print_png(stream, metadata={"Software": None})
    return stream.getvalue()


def save_png(drawing: Drawing, path: Path) -> None:
    """Write the picture whole or not at all."""
    write_bytes(path, render_png(drawing))


def _paint(axes: Axes, shape: Shape, order: int) -> None:
    from matplotlib.patches import Circle, FancyArrowPatch, Rectangle

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
                zorder=order,
            )  # fmt: skip


def _write_header(figure: Any, drawing: Drawing, lines: list[str], total: float) -> None:
    left = MARGIN_IN / WIDTH_IN
    top = 1 - 0.30 / total
    figure.text(left, top, drawing.title, fontsize=15, weight="bold", color=INK, va="center")
    notes = "  ·  ".join(drawing.notes)
    figure.text(1 - left, top, notes, fontsize=8.5, color=FAINT, va="center", ha="right")
    for i, line in enumerate(lines):
        y = 1 - (0.60 + LINE_IN * i) / total
        figure.text(left, y, line, fontsize=10.5, color=INK, va="center")


def _write_sides(figure: Any, drawing: Drawing, total: float, height: float) -> None:
    middle = (MARGIN_IN + height / 2) / total
    edge = MARGIN_IN / 2
    style: dict[str, Any] = {
        "fontsize": 9, "weight": "bold", "color": INK, "ha": "center", "va": "center",
    }  # fmt: skip
    sides = drawing.sides
    # A dark bar stands for the robot: nobody should turn the page the wrong way round.
    bar: dict[str, Any] = {"boxstyle": "round,pad=0.45", "facecolor": INK, "edgecolor": "none"}
    figure.text(0.5, edge / total, sides.bottom, **{**style, "color": "white"}, bbox=bar)
    figure.text(0.5, (MARGIN_IN + height + edge / 2) / total, sides.top, **style)
    figure.text(edge / WIDTH_IN, middle, sides.left, rotation=90, **style)
    figure.text(1 - edge / WIDTH_IN, middle, sides.right, rotation=270, **style)
