"""The plots of the HTML report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from codediffuser import svg

_LEFT, _RIGHT = 146, 14


def bar_plot(counts: Mapping[str, int], title: str, css: Mapping[str, str] | None = None) -> str:
    """Horizontal bars, one per named count; `css` gives other classes than `good` by name."""
    step, top = 30, 4
    most = max(counts.values(), default=1)
    room = svg.WIDTH - _LEFT - _RIGHT - 24
    parts = []
    for i, (name, count) in enumerate(counts.items()):
        y, width = top + step * i, room * count / most
        shown = name.replace("_", " ")
        bar = svg.rect("bar", _LEFT, y + 5, width, step - 10, radius=4)
        parts.append(svg.group((css or {}).get(name, "good"), f"{shown}: {count}", bar))
        parts.append(svg.text(_LEFT - 10, y + step / 2 + 4, _short(shown), "end label"))
        parts.append(svg.text(_LEFT + width + 7, y + step / 2 + 4, str(count), "count"))
    return svg.drawing(top + step * len(counts) + 4, parts, title)


def histogram(values: Sequence[float], unit: str, title: str, bins: int = 24) -> str:
    """How values spread, from the smallest to the largest."""
    counts, edges = np.histogram(values, bins=bins)
    top, bottom, left = 14, 118, 20
    wide = (svg.WIDTH - 2 * left) / bins
    parts = [svg.line("axis", left, bottom, svg.WIDTH - left, bottom)]
    for i, count in enumerate(counts):
        if count:
            tall = (bottom - top) * count / max(counts)
            bar = svg.rect(
                "bar", left + wide * i + 0.6, bottom - tall, wide - 1.2, tall, radius=1.5
            )
            tip = f"{edges[i]:.3g} to {edges[i + 1]:.3g} {unit}: {count}"
            parts.append(svg.group("good", tip, bar))
    for share in (0, 0.5, 1):
        value = edges[0] + share * (edges[-1] - edges[0])
        x = left + share * (svg.WIDTH - 2 * left)
        parts.append(svg.text(x, bottom + 16, f"{value:.3g}", "mid tick"))
    parts.append(svg.text(svg.WIDTH / 2, bottom + 30, unit, "mid note"))
    return svg.drawing(bottom + 36, parts, title)


def band_plot(values: np.ndarray, title: str, css: str = "good") -> str:
    """A number over the course of an episode: all of it, its middle half, its median.

    Args:
        values: (E, M) float, M evenly spread moments of E episodes.
        title: Said to those who do not see the plot.
        css: `good` or `attention`.
    """
    top, bottom, left, right = 8, 96, 48, 8
    room, moments = svg.WIDTH - left - right, values.shape[1]
    low, high = float(values.min()), float(values.max())
    if low == high:  # a constant is a line in the middle
        low, high = low - 1, high + 1
    span = high - low
    x = left + room * np.arange(moments) / max(1, moments - 1)

    def curve(row: np.ndarray) -> list[tuple[float, float]]:
        y = bottom - (row - low) / span * (bottom - top)
        return [(float(a), float(b)) for a, b in zip(x, y, strict=True)]

    quantiles = np.quantile(values, [0, 0.25, 0.5, 0.75, 1], axis=0)
    tip = f"{title}: {low:.4g} to {high:.4g}, median {np.median(values):.4g}"
    parts = [svg.line("grid", left, y, svg.WIDTH - right, y) for y in (top, bottom)]
    parts += [
        svg.text(left - 6, bottom + 4, f"{low:.3g}", "end tick"),
        svg.text(left - 6, top + 4, f"{high:.3g}", "end tick"),
        svg.group(
            css, tip,
            svg.path("band", curve(quantiles[0]) + curve(quantiles[4])[::-1], closed=True),
            svg.path("inner", curve(quantiles[1]) + curve(quantiles[3])[::-1], closed=True),
            svg.path("middle", curve(quantiles[2])),
        ),
        svg.text(left, bottom + 16, "start", "tick"),
        svg.text(svg.WIDTH - right, bottom + 16, "end", "end tick"),
    ]  # fmt: skip
    return svg.drawing(bottom + 22, parts, title)


def map_plot(starts: np.ndarray, targets: np.ndarray, title: str) -> str:
    """Where objects stood and where they were to go, seen from above: x to the right, y up.

    Args:
        starts: (E, 2) metres in the world.
        targets: (E, 2) metres in the world.
        title: Said to those who do not see the plot.
    """
    both = np.concatenate([starts, targets])
    low, high = both.min(axis=0) - 0.03, both.max(axis=0) + 0.03
    left, top = 44, 8
    scale = min((svg.WIDTH - left - 8) / (high[0] - low[0]), 300 / (high[1] - low[1]))
    wide, tall = (high - low) * scale

    def place(point: np.ndarray) -> tuple[float, float]:
        x, y = (point - low) * scale
        return left + float(x), top + float(tall - y)

    parts = [svg.rect("box", left, top, wide, tall, radius=4)]
    for css, points, what in (("good", starts, "start"), ("attention", targets, "target")):
        for point in points:
            tip = f"{what} {point[0]:.3f}, {point[1]:.3f} m"
            parts.append(svg.group(css, tip, svg.circle("speck", *place(point), 3)))
    for i, (x, anchor) in enumerate(((left, ""), (left + wide, "end "))):
        parts.append(svg.text(x, top + tall + 16, f"{(low, high)[i][0]:.2f} m", f"{anchor}tick"))
    parts.append(svg.text(left - 6, top + 10, f"{high[1]:.2f} m", "end tick"))
    parts.append(svg.text(left - 6, top + tall, f"{low[1]:.2f}", "end tick"))
    return svg.drawing(float(tall) + top + 22, parts, title)


def _short(name: str, most: int = 22) -> str:
    return name if len(name) <= most else f"{name[: most - 1]}…"
