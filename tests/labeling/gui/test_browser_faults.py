"""What may go wrong, in a real browser: tabs that race, damaged files, cameras that see nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from codediffuser.labeling.auto import label_episode
from codediffuser.labeling.gui.app import LabelApp
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.scripted import WAIT_MS, ScriptedOperator
from codediffuser.labeling.store import LABELS, load_document

pytestmark = pytest.mark.gui


def choose(operator: ScriptedOperator, desk: Desk, *names: str) -> None:
    """Click instances one after the other, each once the one before is on disk."""
    scene = desk.scene(operator.episode())
    for number, name in enumerate(names, start=1):
        operator.click(operator.spot(scene, name))
        operator.wait_for_chosen(*names[:number])


def test_two_tabs_race_on_one_episode_and_nothing_is_lost(run: Path, context: Any) -> None:
    app = LabelApp(Desk(run), operator="ada", port=0)
    try:
        # A window of its own: the browser stops what lies behind another tab of one window.
        window = context.browser.new_context(viewport={"width": 760, "height": 480})
        window.set_default_timeout(WAIT_MS)
        first, second = (ScriptedOperator(each, app.url) for each in (context, window))
        episode = first.episode()
        assert second.episode() != episode  # the queue gives no episode to two tabs
        second.open_episode(episode)
        second.wait_for_episode(episode)
        choose(first, app.desk, "battery_0", "slot_0")
        choose(second, app.desk, "battery_0", "slot_1")
        assert first.chosen() == ("battery_0", "slot_0")  # each tab has its own selection

        first.press("Enter")
        first.wait_for_other(episode)
        second.press("Enter")
        second.wait_for("saved revision 1 meanwhile. Your selection is kept")
        assert second.chosen() == ("battery_0", "slot_1")
        document = load_document(run / "episodes" / episode)
        assert document is not None and document.revision == 1

        second.press("m")
        second.wait_for_other(episode)
        document = load_document(run / "episodes" / episode)
        assert document is not None
        revisions = [[e.instance_id for e in r.labels] for r in document.revisions()]
        assert sorted(revisions) == [["battery_0", "slot_0"], ["battery_0", "slot_1"]]
        assert [e.instance_id for e in document.labels] == ["battery_0", "slot_1"]
    finally:
        app.close()


def test_what_cannot_be_labelled_is_said_kept_and_left_behind(
    run: Path, blind_episode: str, context: Any
) -> None:
    newer, torn = (run / "episodes" / name for name in ("000001", "000002"))
    for folder in (newer, torn):
        label_episode(folder)
    raw = json.loads((newer / LABELS).read_text())
    (newer / LABELS).write_text(json.dumps({**raw, "schema": "codediffuser.labels/9"}))
    (torn / LABELS).write_text((torn / LABELS).read_text()[:-30])
    before = [(folder / LABELS).read_bytes() for folder in (newer, torn)]
    app = LabelApp(Desk(run), operator="ada", port=0)
    try:
        operator = ScriptedOperator(context, app.url)
        for episode, said in (
            ("000001", "newer than this codediffuser"),
            ("000002", "not JSON"),
            (blind_episode, "the cameras show nothing to choose"),
        ):
            operator.open_episode(episode)
            operator.wait_for_episode(episode)
            operator.wait_for(said)
            operator.press("Enter")  # refused
            operator.wait_for("missing")
        operator.open_episode("000003")
        operator.wait_for_episode("000003")
        choose(operator, app.desk, "battery_0", "slot_0")
        operator.press("Enter")
        operator.wait_for_other("000003")
        assert load_document(run / "episodes" / "000003") is not None
    finally:
        app.close()
    assert [(folder / LABELS).read_bytes() for folder in (newer, torn)] == before
