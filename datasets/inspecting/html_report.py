"""One self-contained HTML page about a run or a dataset."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser import __version__
from codediffuser.datasets.inspecting import plots
from codediffuser.datasets.inspecting.summary_text import human_bytes, trained_and_held_out
from codediffuser.datasets.inspecting.survey import NOT_RECORDED, SUCCESS, Motion, Survey
from codediffuser.files import write_text
from codediffuser.labeling.label import ROLES
from codediffuser.report_page import markup, render_page

TEMPLATE = Path(__file__).with_name("report_template.html")
MAX_SENTENCES = 40


def write_html(survey: Survey, motion: Motion | None, path: Path) -> Path:
    """Write the report of a survey; a plot whose numbers are not stored is left out.

    Args:
        survey: What it is about.
        motion: For the curves over time; None leaves them out.
        path: The file.
    """
    write_text(path, render_html(survey, motion))
    return path


def render_html(survey: Survey, motion: Motion | None) -> str:
    """Build the page's text; see `write_html`."""
    sentences = survey.instructions
    shown = [
        (text, n, next(e.kind for e in survey.episodes if e.instruction == text))
        for text, n in list(sentences.items())[:MAX_SENTENCES]
    ]
    return render_page(
        TEMPLATE,
        version=__version__,
        survey=survey,
        name=survey.path.resolve().name,
        task=", ".join(survey.count("task")),
        minutes=survey.hours * 60,
        solved=survey.outcomes.get(SUCCESS, 0),
        tried=sum(survey.outcomes.values()),
        disk=human_bytes(sum(survey.bytes_by_part.values())),
        sizes={part: human_bytes(size) for part, size in survey.bytes_by_part.items()},
        sentences=shown,
        more=len(sentences) - len(shown),
        splits=trained_and_held_out(survey),
        plots=[(title, note, markup(svg)) for title, note, svg in _plots(survey)],
        curves=_curves(motion),
        curved=0 if motion is None else len(motion.state),
        attention=_attention(motion),
    )


def _plots(survey: Survey) -> list[tuple[str, str, str]]:
    outcomes = survey.outcomes
    lengths = [e.frames / e.hz for e in survey.episodes]
    found = [
        ("Outcomes", "Attempts that are known here, failures with their phase or reason.",
         plots.bar_plot(outcomes, "Outcomes", {k: "bad" for k in outcomes if k != SUCCESS})),
        ("Episode lengths", f"{min(lengths):.1f} to {max(lengths):.1f} s.",
         plots.histogram(lengths, "s", "Episode lengths")),
    ]  # fmt: skip
    for title, attribute in (("Kinds of instruction", "kind"), ("Splits of scenes", "split")):
        counts = survey.count(attribute)  # type: ignore[arg-type]
        if set(counts) != {NOT_RECORDED}:
            found.append((title, "Episodes.", plots.bar_plot(counts, title)))
    labels = Counter(f"{label.role}: {label.source}" for e in survey.episodes for label in e.labels)
    if labels:
        note = f"Who set them; {survey.unlabeled} episodes have none."
        css = dict.fromkeys(labels, "attention")
        found.append(("Labels by source", note, plots.bar_plot(labels, "Labels by source", css)))
    points = [label.num_points for e in survey.episodes for label in e.labels]
    if points:
        found.append(("Points of a label", "At the first frame.",
                      plots.histogram(points, "points", "Points of a label")))  # fmt: skip
    pairs = [
        (e.start_m, e.target_m) for e in survey.episodes if e.start_m and e.target_m
    ]  # fmt: skip
    if pairs:
        starts, targets = (np.array([pair[i] for pair in pairs]) for i in (0, 1))
        found.append(("Starts and targets from above",
                      "Blue: where the object stood. Yellow: where it was to go.",
                      plots.map_plot(starts, targets, "Starts and targets")))  # fmt: skip
    return found


def _curves(motion: Motion | None) -> list[tuple[str, Any, Any]]:
    """For each number its name, its plot as state and its plot as action."""
    if motion is None:
        return []
    found = []
    names = dict.fromkeys([*motion.state_names, *motion.action_names])
    for name in names:
        pair = []
        for what, values, known in (
            ("state", motion.state, motion.state_names),
            ("action", motion.action, motion.action_names),
        ):
            drawn = ""
            if name in known:
                drawn = plots.band_plot(values[:, :, known.index(name)], f"{what} {name}")
            pair.append(markup(drawn))
        found.append((name, *pair))
    return found


def _attention(motion: Motion | None) -> list[tuple[str, Any]]:
    if motion is None or motion.attention is None:
        return []
    return [
        (role, markup(plots.band_plot(motion.attention[:, :, i], f"points to {role}", "attention")))
        for i, role in enumerate(ROLES)
    ]
