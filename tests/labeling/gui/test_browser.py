"""A real browser on a real rendered episode: what an operator sees and does, end to end."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codediffuser.labeling.auto import label_episode
from codediffuser.labeling.gui.app import LabelApp
from codediffuser.labeling.gui.bench import label_all, operator_view, true_targets
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.scripted import ScriptedOperator, find_chromium, open_browser
from codediffuser.labeling.store import load_labels

pytestmark = [pytest.mark.gui, pytest.mark.sim]
TASKS = [
    "pack_battery",
    pytest.param("hang_mug", marks=pytest.mark.slow),
    pytest.param("stow_book", marks=pytest.mark.slow),
]
HALO_RGB = (240, 235, 100)


@pytest.fixture(scope="module")
def rendered(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A task's first two demonstrated scenes, small pictures."""
    from codediffuser.cli import run as command

    find_chromium()
    run = tmp_path_factory.mktemp(request.param)
    sample = ["sample", request.param, "--out", str(run / "scenes"), "-n", "2", "--seed", "3"]
    assert command(sample) == 0
    assert command(["demo", str(run), "--size", "160x120"]) == 0
    return run


@pytest.fixture
def app(rendered: Path) -> Iterator[LabelApp]:
    app = LabelApp(Desk(rendered), operator="ada", port=0)
    yield app
    app.close()


@pytest.fixture
def context() -> Iterator[Any]:
    with open_browser(1000, 640) as context:
        yield context


def count_of(operator: ScriptedOperator, rgb: tuple[int, int, int]) -> int:
    """How many pixels of the view have about this colour."""
    box = operator.canvas()
    shot = Image.open(io.BytesIO(operator.screenshot())).convert("RGB")
    pixels = np.array(shot)[:, : int(box["width"])].astype(int)
    return int((np.abs(pixels - rgb).max(axis=-1) < 40).sum())


@pytest.mark.parametrize("rendered", TASKS, indirect=True)
def test_an_operator_labels_a_run(rendered: Path, app: LabelApp, context: Any) -> None:
    desk, operator = app.desk, ScriptedOperator(context, app.url)
    first = operator.episode()
    scene = desk.scene(first)
    view = operator_view(scene)
    pick, place = true_targets(scene)
    at = operator.spot(scene, pick, view)

    before = count_of(operator, HALO_RGB)
    operator.hover(at)
    operator.until(lambda: count_of(operator, HALO_RGB) > before + 50, "the halo of nearness")

    # The browser draws lines a little paler than their colour.
    selected = (255, 77, 0) if view == "top" else (70, 208, 80)
    before = count_of(operator, selected)
    operator.click(at)
    operator.wait_for_chosen(pick)
    operator.until(lambda: count_of(operator, selected) > before + 50, "the selection's colour")
    operator.click(operator.spot(scene, place, view))
    operator.wait_for_chosen(pick, place)

    operator.click(at)
    operator.wait_for_chosen(place)
    operator.press("u")
    operator.wait_for_chosen(pick, place)

    operator.load()
    operator.wait_for_chosen(pick, place)
    assert operator.episode() == first

    operator.press("Enter")
    operator.wait_for_other(first)
    operator.press("p")
    label_all(operator, desk, 1)

    for folder in sorted((rendered / "episodes").iterdir()):
        mine, true = load_labels(folder), label_episode(folder, overwrite=True)
        for label, expected in zip(mine.labels, true.labels, strict=True):
            assert label.instance_id == expected.instance_id
            assert np.array_equal(label.points_world, expected.points_world)
