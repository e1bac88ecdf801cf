"""An episode's motion as curves: measured against commanded, from above, and the gripper."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.pictures import stored_recovery
from codediffuser.files import atomic_path

COLORS = ("#d1495b", "#2e8b57", "#3366cc")
MEASURED, COMMANDED = "-", ":"


def save_motion_plot(episode: Episode, path: Path) -> None:
    """Draw the motion of an episode to a PNG.

    Hand episodes show position, speed, opening and the way over the table; others show every number
    of state and action under its name.
    """
    figure = Figure(figsize=(12, 7), layout="constrained")
    figure.suptitle(f"{episode.manifest.task} {episode.id}: {episode.manifest.instruction}")
    if episode.manifest.motion.kind == "hand":
        _plot_hand(figure, episode)
    else:
        _plot_joints(figure, episode)
    with atomic_path(path) as partial:
        figure.savefig(partial, dpi=100)


def _plot_hand(figure: Figure, episode: Episode) -> None:
    position, speed, opening = (figure.add_subplot(3, 2, k) for k in (1, 3, 5))
    above = figure.add_subplot(1, 2, 2)
    time_s = np.arange(episode.num_frames) / episode.hz
    state, actions = episode.state, episode.actions
    for axis, (name, color) in enumerate(zip("xyz", COLORS, strict=True)):
        position.plot(time_s, state[:, axis], MEASURED, color=color, label=name)
        position.plot(time_s, actions[:, axis], COMMANDED, color=color)
    position.set_ylabel("hand, m")
    position.legend(ncols=3, title="measured, dotted: commanded", fontsize=8, title_fontsize=8)
    step_m = np.linalg.norm(np.diff(state[:, :3], axis=0), axis=1)
    speed.plot(time_s[1:], step_m * episode.hz, color="#444444")
    speed.set_ylabel("hand speed, m/s")
    opening.plot(time_s, state[:, 9] * 1000, MEASURED, color="#8b5a2b", label="measured")
    opening.plot(time_s, actions[:, 9] * 1000, COMMANDED, color="#8b5a2b", label="commanded")
    opening.set_ylabel("finger opening, mm")
    opening.set_xlabel("time, s")
    opening.legend(fontsize=8)
    _mark_push(episode, (position, speed, opening))
    _plot_from_above(above, state)


def _mark_push(episode: Episode, plots: tuple[Axes, ...]) -> None:
    recovery = stored_recovery(episode)
    if recovery is None:
        return
    start_s = recovery.first_step / episode.hz
    for plot in plots:
        plot.axvspan(
            start_s, start_s + recovery.push.steps / episode.hz, color="#f4a261", alpha=0.4
        )
    plots[0].set_title("shaded: the hand is pushed", fontsize=9)


def _plot_from_above(plot: Axes, state: np.ndarray) -> None:
    plot.plot(state[:, 0], state[:, 1], color="#bbbbbb", zorder=1)
    dots = plot.scatter(state[:, 0], state[:, 1], c=state[:, 2], s=12, cmap="viridis", zorder=2)
    plot.figure.colorbar(dots, ax=plot, label="height of the hand, m", shrink=0.7)
    for k, name, down in ((0, "start", 6), (-1, "end", -14)):
        at = (state[k, 0], state[k, 1])
        plot.annotate(name, at, textcoords="offset points", xytext=(6, down))
    plot.set_aspect("equal")
    plot.set_xlabel("x, m (right of the robot)")
    plot.set_ylabel("y, m (away from the robot)")


def _plot_joints(figure: Figure, episode: Episode) -> None:
    motion = episode.manifest.motion
    time_s = np.arange(episode.num_frames) / episode.hz
    plots = figure.subplots(2, 1, sharex=True)
    for plot, rows, names, what in (
        (plots[0], episode.state, motion.state_names, "state"),
        (plots[1], episode.actions, motion.action_names, "action"),
    ):
        for column, name in enumerate(names):
            plot.plot(time_s, rows[:, column], label=name)
        plot.set_ylabel(what)
        plot.legend(fontsize=7, ncols=4)
    plots[1].set_xlabel("time, s")
