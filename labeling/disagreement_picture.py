"""Draws what several labelers chose in one episode, side by side, seen from above."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import get_task
from codediffuser.errors import CodeDiffuserError
from codediffuser.labeling.auto import start_cloud
from codediffuser.labeling.label import AttentionLabel

ROLE_COLORS = {"pick": "#ff4d00", "place": "#00a050"}
BACKGROUND_POINTS = 12_000


def draw_disagreement(folder: Path, said: Mapping[str, Sequence[AttentionLabel]]) -> bytes:
    """Draw one panel per labeler: the cloud in grey, the chosen points in the role's colour.

    Args:
        folder: Episode folder; one whose log is damaged is drawn without the cloud.
        said: Labels by labeler.

    Returns:
        PNG.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    instruction, cloud = _background(folder)
    figure = Figure(figsize=(3.6 * len(said), 4.0), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    figure.suptitle(f"{folder.name}: {instruction}", fontsize=9, parse_math=False)
    panels: Any = figure.subplots(1, len(said), squeeze=False)[0]
    for axes, (labeler, labels) in zip(panels, said.items(), strict=True):
        axes.scatter(cloud[:, 0], cloud[:, 1], s=0.6, c="#b8b8b8", linewidths=0)
        for label in labels:
            points = label.points_world
            color = ROLE_COLORS[label.role]
            axes.scatter(points[:, 0], points[:, 1], s=1.6, c=color, linewidths=0)
            x, y = points[:, :2].mean(axis=0)
            axes.annotate(
                f"{label.role}: {label.instance_id}", (x, y), xytext=(0, 12), ha="center",
                textcoords="offset points", fontsize=8, color=color, parse_math=False,
            )  # fmt: skip
        axes.set_title(labeler, fontsize=9, parse_math=False)
        axes.set_aspect("equal")
        axes.set_axis_off()
    stream = io.BytesIO()
    canvas.print_png(stream)
    return stream.getvalue()


def _background(folder: Path) -> tuple[str, np.ndarray]:
    try:
        episode = Episode.open(folder)
        cloud = start_cloud(episode, get_task(episode.manifest.task))
    except CodeDiffuserError as error:
        return str(error), np.zeros((0, 3), np.float32)
    stride = max(1, len(cloud) // BACKGROUND_POINTS)
    return episode.manifest.instruction, cloud[::stride]
