"""One self-contained `report.html`: no script, style, font, picture or video from elsewhere."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from codediffuser.datagen.trajectory import CONTROL_HZ
from codediffuser.eval import plots
from codediffuser.eval.results import ConditionSummary, EvalResults, RateValue, RolloutResult
from codediffuser.files import write_text
from codediffuser.report_page import markup, render_page

TEMPLATE = Path(__file__).with_name("report_template.html")
MAX_VIDEO_BYTES = 24_000_000
"""Videos inside the page in total; failures come first, the rest stays in files beside it."""

_MAX_PAIRS_SHOWN = 4
_NOTHING = 5e-5
"""Values below are shown as 0: far below what any condition resolves."""


@dataclass(frozen=True, slots=True)
class _Media:
    strip: str | None
    video: str | None


@dataclass(frozen=True, slots=True)
class _Histogram:
    title: str
    note: str
    svg: Any


def write_report(results: EvalResults, folder: Path) -> Path:
    """Write `folder/report.html` from the results and the pictures in `folder/rollouts/`.

    Pictures or videos that are missing leave a gap in the page, never an error.

    Args:
        results: Everything that is shown.
        folder: The evaluation's folder, with `rollouts/<scene id>/`.

    Returns:
        Path of the report.
    """
    path = folder / "report.html"
    write_text(path, render_report(results, folder))
    return path


def render_report(results: EvalResults, folder: Path) -> str:
    """Build the page's text; see `write_report`."""
    rollouts, summary = results.rollouts, results.summary
    return render_page(
        TEMPLATE,
        settings=results.settings,
        repro=results.reproducibility,
        summary=summary,
        comparisons=results.comparisons,
        rollouts=rollouts,
        headline=f"{_percent(summary.success)} success",
        created=results.reproducibility.created_at.replace("T", " ").replace("Z", " UTC"),
        attention_sentence=_attention_sentence(results),
        stress_sentence=_stress_sentence(results),
        failed=sum(not r.success for r in rollouts),
        wrong=sum(not r.attention.right for r in rollouts),
        moment=sum(r.ever_success and not r.success for r in rollouts),
        plots=_plots(results),
        media=_media(rollouts, folder),
        percent=_percent,
        interval=_interval,
        number=_number,
        seconds=_seconds,
        p_value=_p_value,
        allowed=_allowed,
        at=_at,
    )


def _plots(results: EvalResults) -> dict[str, Any]:
    summary = results.summary
    rows = [(k.replace("_", " "), "good", v) for k, v in summary.by_kind.items()]
    rows.append(("all", "muted", summary.success))
    attention = [
        (k.replace("_", " "), "attention", v) for k, v in summary.attention_by_kind.items()
    ]
    times = [r.first_success_step for r in results.rollouts if r.first_success_step is not None]
    return {
        "by_kind": markup(plots.interval_plot(rows)),
        "attention_by_kind": markup(plots.interval_plot(attention))
        if results.settings.attention == "language"
        else None,
        "failures": markup(plots.bar_plot(summary.failures)),
        "ambiguity": markup(plots.heat_map(summary.by_ambiguity)),
        "time": markup(
            plots.time_curve(times, len(results.rollouts), results.settings.max_steps, CONTROL_HZ)
        )
        if times
        else None,
        "histograms": [
            _histogram(c, results) for c in summary.conditions if c.name.endswith("distance_m")
        ],
    }


def _histogram(condition: ConditionSummary, results: EvalResults) -> _Histogram:
    pairs = [
        (c.value, c.holds)
        for r in results.rollouts
        if r.final is not None
        for c in r.final.conditions
        if c.name == condition.name and c.value is not None
    ]
    svg = plots.histogram(
        [value for value, _ in pairs],
        [holds for _, holds in pairs],
        condition.threshold,
        unit="mm",
        scale=1000.0,
        limit=2 * condition.threshold,
    )
    title = condition.name.removesuffix("_m").replace("_", " ")
    return _Histogram(
        title=f"How close: {title}",
        note="Last state, nearest allowed pair; the last bar holds all that lie farther.",
        svg=markup(svg),
    )


def _media(rollouts: tuple[RolloutResult, ...], folder: Path) -> dict[str, _Media]:
    """Encode strips of all rollouts and as many videos as fit, failures first."""
    room = MAX_VIDEO_BYTES
    found = {}
    for r in sorted(rollouts, key=lambda r: (r.success, r.scene_id)):
        home = folder / "rollouts" / r.scene_id
        strip = _read(home, r.keyframes)
        video = _read(home, r.video)
        if video is not None and len(video) > room:
            video = None
        room -= len(video or b"")
        found[r.scene_id] = _Media(strip=_encode(strip), video=_encode(video))
    return found


def _read(folder: Path, name: str | None) -> bytes | None:
    if name is None or not (folder / name).is_file():
        return None
    return (folder / name).read_bytes()


def _encode(data: bytes | None) -> str | None:
    return None if data is None else base64.b64encode(data).decode()


def _attention_sentence(results: EvalResults) -> str:
    if results.settings.attention == "language":
        return (
            "The policy was given only the instruction: a program, written by "
            f"'{results.settings.language_model}', chose what it attends to."
        )
    return "The policy was given the scene's true target, so this measures motion alone."


def _stress_sentence(results: EvalResults) -> str:
    settings = results.settings
    if settings.stress == "zeroed":
        return " Stress: the attention channels were set to zero."
    if settings.stress == "swapped":
        share = f"{settings.swap_share:.0%}"
        return f" Stress: {share} of the attended points were swapped for wrong ones."
    return ""


def _percent(value: RateValue) -> str:
    return "–" if value.share is None else f"{100 * value.share:.0f} %"


def _interval(value: RateValue) -> str:
    if value.share is None:
        return "(no rollout)"
    return f"[{100 * value.low:.0f} – {100 * value.high:.0f} %]"


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return "0" if abs(value) < _NOTHING else f"{value:.3g}"


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} s"


def _at(step: int | None) -> str:
    return "–" if step is None else f"{step / CONTROL_HZ:.1f} s"


def _p_value(value: float) -> str:
    return f"{value:.2g}" if value >= 0.0001 else "< 0.0001"


def _allowed(rollout: RolloutResult) -> str:
    pairs = [f"{pick} → {place}" for pick, place in rollout.judged_pairs]
    more = len(pairs) - _MAX_PAIRS_SHOWN
    return ", ".join(pairs[:_MAX_PAIRS_SHOWN]) + (f" and {more} more" if more > 0 else "")
