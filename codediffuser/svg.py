"""Marks of small plots as SVG text whose colours come from the page: light and dark both work.

`report.css` says what the classes look like. Every drawing is `WIDTH` units wide and scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

WIDTH = 350


def group(css: str, tip: str, *parts: str) -> str:
    """Marks that share a class and a tip."""
    return f'<g class="{css}"><title>{escape(tip)}</title>{"".join(parts)}</g>'


def line(css: str, x1: float, y1: float, x2: float, y2: float) -> str:
    """A straight line."""
    return f'<line class="{css}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def rect(
    css: str, x: float, y: float, width: float, height: float, *, radius: float,
    opacity: float | None = None,
) -> str:  # fmt: skip
    """A rectangle with round corners."""
    filled = "" if opacity is None else f' fill-opacity="{opacity:.3f}"'
    return (
        f'<rect class="{css}" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" '
        f'height="{height:.1f}" rx="{radius}"{filled}/>'
    )


def circle(css: str, x: float, y: float, radius: float) -> str:
    """A disc."""
    return f'<circle class="{css}" cx="{x:.1f}" cy="{y:.1f}" r="{radius}"/>'


def path(css: str, points: Sequence[tuple[float, float]], *, closed: bool = False) -> str:
    """A line through points; closed, an area."""
    steps = "L".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<path class="{css}" d="M{steps}{"Z" if closed else ""}"/>'


def text(x: float, y: float, words: str, css: str) -> str:
    """Words at a place; the class decides which end of them that is."""
    return f'<text class="{css}" x="{x:.1f}" y="{y:.1f}">{escape(words)}</text>'


def drawing(height: float, parts: Sequence[str], title: str) -> str:
    """A whole plot."""
    return (
        f'<svg class="plot" viewBox="0 0 {WIDTH} {height:.0f}" role="img" '
        f'aria-label="{escape(title)}">{"".join(parts)}</svg>'
    )
