"""Reference mode in a real browser: pixels are clicked, counted, taken back and kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codediffuser.labeling.gui.app import LabelApp
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.reference_book import ReferenceBook
from codediffuser.labeling.gui.scripted import ScriptedOperator

pytestmark = pytest.mark.gui


def test_an_operator_collects_references(run: Path, tmp_path: Path, context: Any) -> None:
    book = ReferenceBook("oracle", tmp_path / "oracle.json")
    app = LabelApp(Desk(run, references=book), operator="ada", port=0)
    try:
        operator = ScriptedOperator(context, app.url)
        scene = app.desk.scene(operator.episode())
        camera = next(iter(scene.cameras))
        operator.press("i")
        operator.wait_for_references(battery=0, slot=0, background=0)
        photo = scene.through(camera)
        on_pick = photo.points[photo.owner == [i.id for i in scene.instances].index("battery_0")]
        aim = on_pick[len(on_pick) // 2]
        operator.click(operator.place(scene, aim, camera))
        operator.wait_for_references(battery=1, slot=0, background=0)
        # What was clicked is the pixel that was aimed at, within the window's own rounding.
        library = book.read()
        assert library is not None
        assert np.abs(np.array(library.references[0].pixel) - aim).max() <= 1
        assert library.references[0].camera == camera

        operator.press("z")
        operator.press("z")
        operator.wait_for("a click keeps the pixel as background")
        operator.click(operator.place(scene, np.array([3, 3]), camera))
        operator.wait_for_references(battery=1, slot=0, background=1)
        operator.press("u")
        operator.wait_for_references(battery=1, slot=0, background=0)
        assert operator.chosen() == ()

        operator.load()
        operator.press("i")
        operator.wait_for_references(battery=1, slot=0, background=0)
        operator.press("i")
        operator.click(operator.spot(scene, "battery_0", camera))
        operator.wait_for_chosen("battery_0")
    finally:
        app.close()
