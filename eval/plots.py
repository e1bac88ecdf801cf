"""Small plots as SVG text that takes its colours from the page, so light and dark both work.

Drawn here rather than by matplotlib: the report needs five simple shapes, readable on a phone,
whose text is text and whose colours follow the reader's theme.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from codediffuser import svg
from codediffuser.eval.results import CellValue, RateValue

_LEFT = 122
_RIGHT = 14


def interval_plot(rows: Sequence[tuple[str, str, RateValue]]) -> str:
    """Shares with their intervals, one row each, on an axis from 0 to 100 %.

    Args:
        rows: Label, CSS class of the mark (`good`, `attention`, `muted`), and the rate.
    """
    step, top = 30, 8
    parts = [_percent_axis(top, top + step * len(rows))]
    for i, (label, css, value) in enumerate(rows):
        y = top + step * (i + 0.5)
        parts.append(svg.text(_LEFT - 10, y + 4, label, "end label"))
        if value.share is None:
            parts.append(svg.text(_LEFT + 4, y + 4, "no scene", "note"))
            continue
        low, high, middle = (_percent_x(v) for v in (value.low, value.high, value.share))
        tip = f"{label}: {value.successes} of {value.trials}, {_range(value)}"
        dot = svg.circle("dot", middle, y, 5.5)
        parts.append(svg.group(css, tip, svg.line("whisker", low, y, high, y), dot))
        # The count goes to whichever side of the interval has room.
        x, side = (low - 8, "end ") if low > _LEFT + 40 else (high + 8, "")
        parts.append(svg.text(x, y + 4, f"{value.successes}/{value.trials}", f"{side}count"))
    return svg.drawing(top + step * len(rows) + 26, parts, "Shares with 95 % intervals")


def bar_plot(counts: Mapping[str, int]) -> str:
    """Horizontal bars, one per named count, in the order given."""
    step, top, left = 30, 4, 146
    most = max(counts.values(), default=1)
    room = svg.WIDTH - left - _RIGHT - 24
    parts = []
    for i, (name, count) in enumerate(counts.items()):
        y, width = top + step * i, room * count / most
        bar = svg.rect("bar", left, y + 5, width, step - 10, radius=4)
        parts.append(svg.group("bad", f"{name}: {count}", bar))
        parts.append(svg.text(left - 10, y + step / 2 + 4, name, "end label"))
        parts.append(svg.text(left + width + 7, y + step / 2 + 4, str(count), "count"))
    return svg.drawing(top + step * len(counts) + 4, parts, "Failures by phase")


def heat_map(cells: Sequence[CellValue]) -> str:
    """Success by number of possible picks (rows) and places (columns); darker is better."""
    picks = sorted({c.picks for c in cells})
    places = sorted({c.places for c in cells})
    left, top = 30, 6
    wide = min(56.0, (svg.WIDTH - left - 4) / max(1, len(places)))
    tall = min(wide, 40.0)
    parts = []
    for cell in cells:
        x, y = left + wide * places.index(cell.places), top + tall * picks.index(cell.picks)
        share = cell.successes / cell.trials
        box = (x + 1, y + 1, wide - 2, tall - 2)
        tip = f"{cell.picks} x {cell.places}: {cell.successes} of {cell.trials}"
        ink = "mid count on-fill" if share > 0.55 else "mid count"
        parts.append(
            svg.group(
                "good", tip, svg.rect("cell", *box, radius=4),
                svg.rect("heat", *box, radius=4, opacity=share),
                svg.text(x + wide / 2, y + tall / 2 + 4, f"{cell.successes}/{cell.trials}", ink),
            )
        )  # fmt: skip
    bottom = top + tall * len(picks)
    for i, n in enumerate(picks):
        parts.append(svg.text(left - 8, top + tall * (i + 0.5) + 4, str(n), "end tick"))
    for i, n in enumerate(places):
        parts.append(svg.text(left + wide * (i + 0.5), bottom + 15, str(n), "mid tick"))
    parts.append(
        svg.text(left, bottom + 33, "columns: free places · rows: objects to pick", "note")
    )
    return svg.drawing(bottom + 40, parts, "Success by ambiguity")


def histogram(
    values: Sequence[float], holds: Sequence[bool], threshold: float, *, unit: str, scale: float,
    bins: int = 24, limit: float | None = None,
) -> str:  # fmt: skip
    """How measured values spread around a threshold, those that hold and those that do not.

    Args:
        values: Finite numbers >= 0 in SI units.
        holds: Whether each satisfies its condition.
        threshold: Drawn as a line, SI units.
        unit: Name of the unit that is shown.
        scale: Shown unit per SI unit.
        bins: Number of bars.
        limit: Values beyond it are collected in the last bar; None takes the largest value.
    """
    top, bottom, left = 20, 118, 20
    room = svg.WIDTH - 2 * left
    high = limit if limit is not None else max([*values, threshold * 1.2])
    counts = {True: [0] * bins, False: [0] * bins}
    for value, good in zip(values, holds, strict=True):
        counts[good][min(bins - 1, max(0, int(value / high * bins)))] += 1
    most = max(1, *(a + b for a, b in zip(counts[True], counts[False], strict=True)))
    parts = [svg.line("axis", left, bottom, left + room, bottom)]
    for i in range(bins):
        y = float(bottom)
        span = f"{high * scale * i / bins:.3g} to {high * scale * (i + 1) / bins:.3g} {unit}"
        for good, css in ((True, "good"), (False, "bad")):
            if counts[good][i]:
                tall = (bottom - top) * counts[good][i] / most
                y -= tall
                x = left + room * i / bins
                bar = svg.rect("bar", x + 0.6, y, room / bins - 1.2, tall, radius=1.5)
                parts.append(svg.group(css, f"{span}: {counts[good][i]}", bar))
    x = left + room * min(1.0, threshold / high)
    parts.append(svg.line("threshold", x, top - 8, x, bottom))
    parts.append(svg.text(x - 5, top - 2, f"limit {threshold * scale:.3g} {unit}", "end note"))
    beyond = max(values, default=0.0) > high
    for i in range(5):
        label = ("≥ " if beyond and i == 4 else "") + f"{high * scale * i / 4:.3g}"
        parts.append(svg.text(left + room * i / 4, bottom + 16, label, "mid tick"))
    parts.append(svg.text(left + room / 2, bottom + 30, unit, "mid note"))
    return svg.drawing(bottom + 36, parts, "Distribution of a measured condition")


def time_curve(first_success_steps: Sequence[int], trials: int, max_steps: int, hz: float) -> str:
    """Share of rollouts that have met every condition at least once by a given time."""
    top, bottom, left = 10, 128, 40
    room, rise = svg.WIDTH - left - 14, (bottom - top) / max(1, trials)
    seconds = max_steps / hz
    parts = []
    for share in (0.0, 0.5, 1.0):
        y = bottom - (bottom - top) * share
        parts.append(svg.line("grid", left, y, left + room, y))
        parts.append(svg.text(left - 8, y + 4, f"{share:.0%}", "end tick"))
    path = f"M{left},{bottom}"
    for done, step in enumerate(sorted(first_success_steps), start=1):
        path += f"H{left + room * step / max_steps:.1f}V{bottom - rise * done:.1f}"
    parts.append(f'<path class="curve" d="{path}H{left + room:.1f}"/>')
    whole = max(1, math.ceil(seconds / 5))
    for t in range(0, math.floor(seconds) + 1, whole):
        parts.append(svg.text(left + room * t / seconds, bottom + 16, f"{t} s", "mid tick"))
    return svg.drawing(bottom + 22, parts, "Share of rollouts that have succeeded by a time")


def _percent_x(share: float) -> float:
    return _LEFT + (svg.WIDTH - _LEFT - _RIGHT) * share


def _percent_axis(top: float, bottom: float) -> str:
    parts = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        x = _percent_x(share)
        parts.append(svg.line("grid", x, top, x, bottom))
        parts.append(svg.text(x, bottom + 16, f"{share:.0%}", "mid tick"))
    return "".join(parts)


def _range(value: RateValue) -> str:
    return f"{value.share:.0%} [{100 * value.low:.0f}, {100 * value.high:.0f}]"
