"""Measures the labeling window: `python -m codediffuser.labeling.gui.bench RUN`.

Two figures: the server's time from a click to the message that recolours the instance, at 50,000
points, and how many episodes a minute a scripted operator labels in a real browser. The operator
works on a copy of the run's episodes without labels.
"""

from __future__ import annotations

import dataclasses
import shutil
import statistics
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.episode_format import EPISODES
from codediffuser.datagen.task import Task
from codediffuser.errors import BelowTargetError, EpisodeError
from codediffuser.labeling.gui.app import LabelApp
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.scripted import ScriptedOperator, open_browser
from codediffuser.labeling.gui.tab import Tab
from codediffuser.labeling.index import LABELING
from codediffuser.labeling.instances import INSTANCE_SOURCES, SelectableInstance
from codediffuser.labeling.oracle_source import OracleSource
from codediffuser.labeling.store import LABELS, POINTS

POINTS_TOTAL = 50_000
MAX_CLICK_S = 0.005
MIN_EPISODES_PER_MIN = 20.0


@dataclasses.dataclass(frozen=True, slots=True)
class GuiBench:
    """What a run measured."""

    points: int
    """Points of all instances that clicks were judged by."""
    clicks: int
    click_ms: float
    """Median from the click's arrival to the sent colours, on the server."""
    episodes: int
    episodes_per_min: float


def bench(run: tyro.conf.Positional[Path], *, clicks: int = 40, episodes: int = 12) -> GuiBench:
    """Measure both figures.

    Args:
        run: Run with simulated episodes.
        clicks: Clicks of the first figure.
        episodes: Episodes of the second; fewer when the run has fewer.

    Raises:
        EpisodeError: The run has no episodes.
        SetupError: Playwright or Chromium is missing.
    """
    with tempfile.TemporaryDirectory() as scratch:
        copy = unlabeled_copy(run, Path(scratch), episodes)
        points, times_s = _click_times(copy, clicks)
        shutil.rmtree(copy / LABELING)
        labeled, minutes = _labeling_speed(copy)
    return GuiBench(points, len(times_s), 1e3 * statistics.median(times_s), labeled,
                    labeled / minutes)  # fmt: skip


def unlabeled_copy(run: Path, scratch: Path, episodes: int) -> Path:
    """Copy the first episodes of a run without what labeling wrote."""
    folders = list_episodes(run)[:episodes]
    if not folders:
        raise EpisodeError(f"{run}: no episodes to measure with; run demo first")
    for folder in folders:
        shutil.copytree(
            folder, scratch / EPISODES / folder.name, ignore=shutil.ignore_patterns(LABELS, POINTS)
        )
    return scratch


def true_targets(scene: EpisodeScene) -> tuple[str, str]:
    """Ids of the object and the place that the demonstration was scripted for."""
    assert scene.episode is not None
    target = scene.episode.scene.target
    return target.pick, target.place


def label_all(operator: ScriptedOperator, desk: Desk, count: int) -> int:
    """Label episodes as a person does, pick, place, Enter; returns how many were done."""
    for done in range(count):
        episode = operator.episode()
        scene = desk.scene(episode)
        targets = true_targets(scene)
        for number, target in enumerate(targets, start=1):
            operator.click(operator.spot(scene, target, operator_view(scene)))
            operator.wait_for_chosen(*targets[:number])
        operator.press("Enter")
        if done + 1 < count:
            operator.wait_for_other(episode)
        else:
            operator.wait_for_submitted()
    return count


def operator_view(scene: EpisodeScene) -> str:
    """What the window opens an episode with: `top`, or a camera."""
    wanted = scene.task.config.labeling.view if scene.task else "top"
    return wanted if wanted in scene.cameras else "top"


@INSTANCE_SOURCES.add("filled oracle")
class FilledOracle:
    """The simulator's instances with as many points as the first figure asks for."""

    def instances(self, episode: Episode, task: Task) -> tuple[SelectableInstance, ...]:
        """The oracle's instances; points are repeated a tenth of a millimetre beside."""
        found = OracleSource().instances(episode, task)
        now = sum(len(i.points_world) for i in found)
        rng = np.random.default_rng(0)
        filled = []
        for instance in found:
            points = instance.points_world
            more = max(0, POINTS_TOTAL - now) * len(points) // now + 1
            added = points[rng.integers(len(points), size=more)]
            added = added + rng.normal(0, 1e-4, added.shape).astype(np.float32)
            filled.append(
                dataclasses.replace(instance, points_world=np.concatenate([points, added]))
            )
        return tuple(filled)


def _click_times(run: Path, clicks: int) -> tuple[int, list[float]]:
    """Click about in one episode and take the times that the tab measured."""
    desk = Desk(run, source="filled oracle")
    app = LabelApp(desk, operator="bench", port=0)
    try:
        with open_browser() as context:
            operator = ScriptedOperator(context, app.url)
            scene = desk.scene(operator.episode())
            tab = next(iter(app.tabs.values()))
            for number in range(clicks):
                instance = scene.instances[number % len(scene.instances)]
                operator.click(operator.spot(scene, instance.id, operator_view(scene)))
                operator.until(partial(_counted, tab, number), "that a click arrived")
            return sum(len(i.points_world) for i in scene.instances), list(tab.timings_s)
    finally:
        app.close()


def _counted(tab: Tab, number: int) -> bool:
    return len(tab.timings_s) > number


def _labeling_speed(run: Path) -> tuple[int, float]:
    """Episodes labelled, and the minutes from the first click to the last saved label."""
    desk = Desk(run)
    app = LabelApp(desk, operator="bench", port=0)
    try:
        with open_browser(960, 600) as context:
            operator = ScriptedOperator(context, app.url)
            began = time.monotonic()
            done = label_all(operator, desk, len(desk.index.rows))
            return done, (time.monotonic() - began) / 60
    finally:
        app.close()


def main() -> None:
    """Print both figures; exit with 3 when one misses its target."""
    result = tyro.cli(bench)
    sys.stdout.write(
        f"click to recolour on the server, {result.points} points: median "
        f"{result.click_ms:.2f} ms of {result.clicks} clicks (target {1e3 * MAX_CLICK_S:.0f} ms)\n"
        f"scripted operator in Chromium: {result.episodes_per_min:.1f} episodes a minute over "
        f"{result.episodes} episodes (target {MIN_EPISODES_PER_MIN:.0f})\n"
    )
    if result.click_ms > 1e3 * MAX_CLICK_S or result.episodes_per_min < MIN_EPISODES_PER_MIN:
        sys.exit(BelowTargetError.exit_code)


if __name__ == "__main__":
    main()
