"""One tab's work: queue, submit, stale submits, flags, reviews, and going on after a restart."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.errors import CodeDiffuserError, LabelError, StaleLabelError
from codediffuser.labeling.auto import label_episode
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.leases import LEASE_S
from codediffuser.labeling.store import LABELS, POINTS, load_labels, save_labels

SitDown = Callable[..., Session]


def choose(session: Session, *names: str) -> None:
    assert session.scene is not None
    for name in names:
        instance = session.scene.instance(name)
        assert instance is not None
        session.toggle(instance)


def shown(session: Session) -> str:
    assert session.scene is not None
    return session.scene.id


def test_submitted_labels_equal_the_ground_truth(desk: Desk, sit_down: SitDown) -> None:
    session = sit_down()
    choose(session, "battery_0", "slot_0")
    session.submit()
    folder = desk.folder("000001")
    mine = load_labels(folder)
    true = label_episode(folder, overwrite=True)
    assert true.revision == mine.revision + 1
    for label, expected in zip(mine.labels, true.labels, strict=True):
        assert np.array_equal(label.points_world, expected.points_world)
        for field in ("role", "category", "instance_id", "follows"):
            assert getattr(label, field) == getattr(expected, field)
        assert label.provenance.source == "human" and label.provenance.labeler == "ada"


def test_the_queue_goes_through_what_is_unlabeled(sit_down: SitDown) -> None:
    session = sit_down()
    seen = []
    for _ in range(3):
        seen.append(shown(session))
        choose(session, "battery_0", "slot_0")
        session.submit()
        session.next()
    assert seen == ["000001", "000002", "000003"]
    assert not session.next() and session.desk.index.count("labeled") == 3


def test_two_tabs_never_get_the_same_episode_from_the_queue(sit_down: SitDown) -> None:
    tabs = [sit_down("ada"), sit_down("bob"), sit_down("ada")]
    assert {shown(tab) for tab in tabs} == {"000001", "000002", "000003"}
    tabs[1].close()
    assert tabs[0].next() and shown(tabs[0]) == "000002"


def test_a_lease_of_a_dead_tab_runs_out(sit_down: SitDown, clock: object) -> None:
    sit_down("ada")
    clock.now_s += LEASE_S + 1  # type: ignore[attr-defined]
    assert shown(sit_down("bob")) == "000001"


def test_incomplete_selections_are_refused_by_name(sit_down: SitDown) -> None:
    session = sit_down()
    choose(session, "battery_0")
    with pytest.raises(LabelError, match="1 slot to place is missing"):
        session.submit()
    assert session.scene is not None
    session.select_box(session.scene.instances)
    with pytest.raises(LabelError, match="1 slot too many to place"):
        session.submit()


def test_a_stale_submit_is_refused_and_nothing_is_lost(desk: Desk, sit_down: SitDown) -> None:
    ada, bob = sit_down("ada"), sit_down("bob")
    assert bob.open("000001") == "ada"
    choose(ada, "battery_0", "slot_0")
    choose(bob, "battery_0", "slot_1")
    ada.submit()
    with pytest.raises(StaleLabelError, match="revision 1 by ada is there, 0 was expected"):
        bob.submit()
    assert bob.draft.chosen("place") == ("slot_1",) and bob.stale is not None
    assert load_labels(desk.folder("000001"))["place"].instance_id == "slot_0"
    bob.keep_mine()
    document = load_labels(desk.folder("000001")).document
    assert document.revision == 2 and document.labels[1].instance_id == "slot_1"
    assert document.history[0].labels[1].instance_id == "slot_0" and document.disagrees


def test_taking_theirs_keeps_mine_one_undo_away(desk: Desk, sit_down: SitDown) -> None:
    ada, bob = sit_down("ada"), sit_down("bob")
    bob.open("000001")
    choose(ada, "battery_0", "slot_0")
    choose(bob, "battery_0", "slot_1")
    ada.submit()
    with pytest.raises(StaleLabelError):
        bob.submit()
    bob.take_theirs()
    assert bob.draft.chosen("place") == ("slot_0",) and bob.stale is None
    bob.undo()
    assert bob.draft.chosen("place") == ("slot_1",)


def test_a_reload_goes_on_where_one_was_with_all_steps(sit_down: SitDown) -> None:
    before = sit_down()
    before.next()
    choose(before, "battery_0", "slot_0", "slot_1")
    before.close()
    after = sit_down()
    assert shown(after) == "000002" and after.draft == before.draft
    after.undo()
    assert after.draft.chosen("place") == ("slot_0",)


def test_a_new_server_goes_on_where_the_old_one_was_killed(run: Path, clock: object) -> None:
    first = Desk(run, clock=clock)  # type: ignore[arg-type]
    before = Session(first, "ada")
    before.start()
    choose(before, "battery_0", "slot_1")
    # No close: a killed process tidies nothing up. Its lease must run out.
    clock.now_s += LEASE_S + 1  # type: ignore[attr-defined]
    second = Desk(run, clock=clock)  # type: ignore[arg-type]
    after = Session(second, "ada")
    after.start()
    assert shown(after) == "000001" and after.draft == before.draft
    first.close()
    second.close()


def test_flags_take_an_episode_out_of_the_queue_and_back(desk: Desk, sit_down: SitDown) -> None:
    session = sit_down()
    with pytest.raises(LabelError, match="a flag needs a reason"):
        session.flag("  ")
    session.flag("camera was moved")
    assert desk.index.ids("flagged") == ["000001"] and "000001" not in desk.index.ids("unlabeled")
    session.unflag()
    assert desk.index.ids("flagged") == []
    assert session.document is not None and session.document.flags[0].withdrawn_by == "ada"


def test_a_rejection_sends_labels_back_with_its_comment(desk: Desk, sit_down: SitDown) -> None:
    session = sit_down()
    choose(session, "battery_0", "slot_1")
    session.submit()
    reviewer = sit_down("eve", filter="to review")
    assert shown(reviewer) == "000001"
    with pytest.raises(LabelError, match="needs a comment"):
        reviewer.review("reject")
    reviewer.review("reject", "the other slot")
    assert desk.index.ids("rejected") == ["000001"] and "000001" in desk.index.ids("unlabeled")
    choose(session, "slot_0")
    session.submit()
    assert desk.index.ids("to review") == ["000001"]
    reviewer.open("000001")
    reviewer.review("accept")
    assert desk.index.count("accepted") == 1


def test_a_review_of_labels_that_changed_meanwhile_is_refused(sit_down: SitDown) -> None:
    session = sit_down()
    choose(session, "battery_0", "slot_1")
    session.submit()
    reviewer = sit_down("eve", filter="to review")
    choose(session, "slot_0")
    session.submit()
    with pytest.raises(StaleLabelError, match="revision 2"):
        reviewer.review("accept")


def test_a_second_opinion_begins_with_nothing_selected(desk: Desk, sit_down: SitDown) -> None:
    session = sit_down()
    choose(session, "battery_0", "slot_1")
    session.submit()
    other = sit_down("bob", filter="second opinion")
    assert shown(other) == "000001" and other.draft.selection == ()
    choose(other, "battery_0", "slot_0")
    other.submit()
    assert desk.index.ids("disagreeing") == ["000001"]
    assert desk.index.ids("second opinion", "bob") == []


@pytest.mark.parametrize("prelabel", ["ground truth", "language"])
def test_prelabels_propose_the_true_targets(sit_down: SitDown, prelabel: str) -> None:
    session = sit_down()
    session.propose(prelabel)
    assert session.draft.selection == (("pick", "battery_0"), ("place", "slot_0"))
    document = session.submit()
    assert document.saved is not None and document.saved.prelabel == prelabel


def test_features_propose_only_what_needs_no_choice(sit_down: SitDown) -> None:
    session = sit_down()
    session.propose("features")
    assert session.draft.selection == (("pick", "battery_0"),)


def test_a_target_that_the_instruction_does_not_allow_is_warned_of(sit_down: SitDown) -> None:
    session = sit_down()
    choose(session, "battery_0", "slot_1")
    assert session.warnings() == ["instruction fits another slot: slot_0"]
    choose(session, "slot_0")
    assert session.warnings() == []


def test_time_away_counts_as_one_minute_at_most(sit_down: SitDown, clock: object) -> None:
    session = sit_down()
    clock.now_s += 4  # type: ignore[attr-defined]
    choose(session, "battery_0")
    clock.now_s += 5000  # type: ignore[attr-defined]
    choose(session, "slot_0")
    saved = session.submit().saved
    assert saved is not None and saved.seconds == pytest.approx(64.0)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / LABELS).write_text("{"), "not JSON"),
        (lambda f: (f / LABELS).write_bytes(b"\xff\xfe"), "cannot be read"),
        (
            lambda f: (f / LABELS).write_text(
                json.dumps({**json.loads((f / LABELS).read_text()),
                            "schema": "codediffuser.labels/9"})
            ),
            "newer than this codediffuser",
        ),
        (lambda f: (f / POINTS).write_bytes(b"nonsense"), "damaged"),
    ],
)  # fmt: skip
def test_damaged_labels_are_shown_and_never_overwritten(
    desk: Desk, sit_down: SitDown, damage: Callable[[Path], object], message: str
) -> None:
    folder = desk.folder("000002")
    label_episode(folder)
    damage(folder)
    bytes_before = [(folder / name).read_bytes() for name in (LABELS, POINTS)]
    session = sit_down()
    session.open("000002")
    assert session.problem == "" or message in session.problem
    choose(session, *(() if session.draft.selection else ("battery_0", "slot_0")))
    choose(session, "slot_1")
    with pytest.raises(CodeDiffuserError, match=message):
        session.submit()
    assert [(folder / name).read_bytes() for name in (LABELS, POINTS)] == bytes_before
    session.next()
    assert shown(session) != "000002"


def test_an_episode_whose_cameras_saw_nothing_can_be_flagged_and_left(
    blind_episode: str, desk: Desk, sit_down: SitDown
) -> None:
    session = sit_down()
    session.open(blind_episode)
    assert "nothing to choose" in session.problem
    with pytest.raises(LabelError, match="missing"):
        session.submit()
    session.flag("all cameras are empty")
    assert session.next() and desk.index.ids("flagged") == [blind_episode]


def test_an_episode_with_a_damaged_log_can_be_skipped(desk: Desk, sit_down: SitDown) -> None:
    log = desk.folder("000001") / "episode.mcap"
    log.write_bytes(log.read_bytes()[:1000])
    session = sit_down()
    assert shown(session) == "000001" and "expected" in session.problem
    with pytest.raises(LabelError):
        session.submit()
    assert session.next() and shown(session) == "000002" and session.problem == ""


def test_the_same_labels_again_are_no_new_revision(desk: Desk, sit_down: SitDown) -> None:
    session = sit_down()
    choose(session, "battery_0", "slot_0")
    session.submit()
    again = save_labels(desk.folder("000001"), load_labels(desk.folder("000001")).labels)
    assert again.revision == 1


@pytest.mark.parametrize("name", ["000009", "../scenes", "", "/etc"])
def test_only_episodes_of_the_run_can_be_opened(sit_down: SitDown, name: str) -> None:
    session = sit_down()
    with pytest.raises(LabelError, match="no episode"):
        session.open(name)
    assert shown(session) == "000001"
