"""A survey as text for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from codediffuser.datasets.inspecting.survey import NOT_RECORDED, Survey
from codediffuser.datasets.splits import split_episodes

EXAMPLES = 5
"""Sentences that are quoted."""
BAR = 24


def summary_text(survey: Survey) -> str:
    """The survey in lines of at most some hundred characters."""
    lines = [f"{survey.what} {survey.path}", *_counts(survey)]
    for title, rows in _sections(survey):
        lines += ["", title, *(f"  {row}" for row in rows)]
    return "\n".join(lines)


def trained_and_held_out(survey: Survey) -> str:
    """How `train` divides the episodes, in words."""
    train, val = split_episodes([e.id for e in survey.episodes])
    return f"{len(train)} train, {len(val)} validate by the hash of each id"


def human_bytes(count: float) -> str:
    """`6.4 MB`."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"


def _counts(survey: Survey) -> Iterator[str]:
    lengths = [e.frames for e in survey.episodes]
    rates = sorted({e.hz for e in survey.episodes})
    yield f"  task       {', '.join(survey.count('task'))}"
    yield f"  episodes   {len(lengths)}"
    yield (
        f"  frames     {survey.frames}; {min(lengths)} to {max(lengths)} each, "
        f"median {np.median(lengths):.0f}; {', '.join(f'{hz:g}' for hz in rates)} Hz"
    )
    yield f"  length     {survey.hours:.2f} h"
    yield f"  splits     {_listed(survey.count('split'))}; {trained_and_held_out(survey)}"
    yield f"  source     {_listed(survey.count('source'))}"
    yield f"  code       {_listed(survey.count('code'))}"


def _sections(survey: Survey) -> Iterator[tuple[str, list[str]]]:
    yield "outcomes", _bars(survey.outcomes)
    kinds = survey.count("kind")
    if set(kinds) != {NOT_RECORDED}:
        yield "kinds of instruction", _bars(kinds)
    sentences = survey.instructions
    quoted = [f"{n:5d} x  {text}" for text, n in list(sentences.items())[:EXAMPLES]]
    yield f"instructions: {len(sentences)} different ones", quoted
    labels = [f"{name}: {_listed(sources)}" for name, sources in survey.labels.items()]
    labels += [f"{survey.unlabeled} episodes have none"] if survey.unlabeled else []
    yield "labels", labels
    if survey.cameras:
        yield "cameras", [f"{name:14} {gives}" for name, gives in survey.cameras.items()]
    yield (
        "features",
        [
            f"{f.name:24} {f.dtype:8} {'x'.join(map(str, f.shape)):12} {f.note}".rstrip()
            for f in survey.features
        ],
    )
    total = sum(survey.bytes_by_part.values())
    yield (
        f"on disk: {human_bytes(total)}",
        [f"{part:26} {human_bytes(size):>8}" for part, size in survey.bytes_by_part.items()],
    )
    if survey.remarks:
        yield "not readable", list(survey.remarks)


def _bars(counts: Mapping[str, int]) -> list[str]:
    most = max(counts.values(), default=1)
    return [
        f"{name:28} {'#' * max(1, round(BAR * n / most)):{BAR}} {n}" for name, n in counts.items()
    ]


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items())
