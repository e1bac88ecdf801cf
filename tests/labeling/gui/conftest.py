"""Runs to label: small synthetic ones, and a desk over them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_writer import EpisodeFacts, write_episode
from codediffuser.datagen.log_step import Pictures, trajectory_steps
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.scripted import find_chromium, open_browser
from codediffuser.labeling.gui.session import Session


class Clock:
    """Time that passes only when a test says so."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def context() -> Iterator[Any]:
    """A small browser window; tests that need another size make their own."""
    find_chromium()
    with open_browser(760, 480) as context:
        yield context


@pytest.fixture(scope="session")
def run_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the first test puts the run that the others copy."""
    return tmp_path_factory.mktemp("template") / "run"


@pytest.fixture
def run(
    tmp_path: Path, run_template: Path, write_battery_episode: Callable[..., Path]
) -> Path:  # fmt: skip
    """Three episodes of one battery and two slots."""
    if not run_template.exists():
        for episode_id in ("000001", "000002", "000003"):
            write_battery_episode(run_template, episode_id, num_steps=3)
    return Path(shutil.copytree(run_template, tmp_path / "run"))


@pytest.fixture
def desk(run: Path, clock: Clock) -> Iterator[Desk]:
    found = Desk(run, clock=clock)
    yield found
    found.close()


@pytest.fixture
def sit_down(desk: Desk) -> Callable[..., Session]:
    """Open another tab and start it."""

    def sit(operator: str = "ada", **options: object) -> Session:
        session = Session(desk, operator)
        for name, value in options.items():
            setattr(session, name, value)
        session.start()
        return session

    return sit


@pytest.fixture
def blind_episode(run: Path) -> str:
    """Id of an episode whose cameras gave no depth reading at all."""
    source = Episode.open(run / "episodes" / "000003")
    scene = source.scene.model_copy(update={"scene_id": "000004"})
    scene_file = run / "scenes" / "000004.yaml"
    scene.save(scene_file)
    pictures = [
        Pictures(
            rgb={n: np.zeros((c.height, c.width, 3), np.uint8) for n, c in source.cameras.items()},
            depth_mm={
                n: np.zeros((c.height, c.width), np.uint16) for n, c in source.cameras.items()
            },
        )
        for _ in range(source.num_frames)
    ]
    write_episode(
        run / "episodes" / "000004",
        EpisodeFacts(
            id="000004", task=scene.task, source="simulation", instruction=scene.instruction.text,
            success=True, seed=scene.seed,
        ),
        source.cameras,
        trajectory_steps(source.trajectory, pictures),
        scene_file=scene_file,
        trajectory=source.trajectory,
    )  # fmt: skip
    return "000004"
