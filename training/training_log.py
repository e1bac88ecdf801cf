"""The log of a training, one JSON object a line, and the picture of its curves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from codediffuser.files import atomic_path, write_text

LOG_FILE = "train_log.jsonl"
PLOT_FILE = "loss.png"

Row = dict[str, Any]


def read_log(out: Path) -> list[Row]:
    """All rows, oldest first; a last line cut off by a kill is left out."""
    path = out / LOG_FILE
    if not path.is_file():
        return []
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return rows


def append_row(out: Path, row: Row) -> None:
    """Add one row."""
    with (out / LOG_FILE).open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(row) + "\n")


def cut_log(out: Path, step: int) -> None:
    """Drop rows after `step`: a continued training writes them again."""
    rows = [row for row in read_log(out) if row["step"] <= step]
    write_text(out / LOG_FILE, "".join(json.dumps(row) + "\n" for row in rows))


def plot_log(out: Path) -> Path | None:
    """Draw loss and held-out position error over the steps; None while there is nothing to draw."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = read_log(out)
    if not rows:
        return None
    figure = Figure(figsize=(8, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot([r["step"] for r in rows], [r["loss"] for r in rows], label="training loss")
    held_out = [r for r in rows if r.get("val_loss") is not None]
    steps = [r["step"] for r in held_out]
    axes.plot(steps, [r["val_loss"] for r in held_out], "o-", ms=3, label="held-out loss")
    axes.set(xlabel="step", ylabel="denoising error", yscale="log")
    axes.grid(alpha=0.3)
    handles, labels = axes.get_legend_handles_labels()
    if held_out:
        right = axes.twinx()
        right.plot(steps, [r["val_error_mm"] for r in held_out], "s--", ms=3, color="tab:green",
                   label="held-out position error")  # fmt: skip
        right.set(ylabel="mm", ylim=(0, None))
        more_handles, more_labels = right.get_legend_handles_labels()
        handles, labels = handles + more_handles, labels + more_labels
    axes.legend(handles, labels)
    with atomic_path(out / PLOT_FILE) as partial:
        figure.savefig(partial, dpi=110)
    return out / PLOT_FILE
