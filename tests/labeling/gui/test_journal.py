"""What the journal has acknowledged comes back, whatever happened to the process or the file."""

from __future__ import annotations

from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from codediffuser.labeling.gui.journal import Based, Chosen, Journal, Opened, Record, Stepped

tabs = st.sampled_from(["t1", "t2"])
episodes = st.sampled_from(["000001", "000002"])
selections = st.lists(
    st.tuples(st.sampled_from(["pick", "place"]), st.sampled_from("abc")),
    max_size=2, unique_by=lambda item: item[1],
).map(tuple)  # fmt: skip
AT = "2026-01-01T00:00:00Z"

records = st.one_of(
    st.builds(Opened, tab=tabs, episode=episodes, at=st.just(AT), selection=selections,
              goes_on_from=st.none() | tabs, base_revision=st.integers(0, 3)),
    st.builds(Chosen, tab=tabs, episode=episodes, at=st.just(AT), selection=selections,
              prelabel=st.none() | st.just("language")),
    st.builds(Stepped, op=st.sampled_from(["undo", "redo"]), tab=tabs, episode=episodes,
              at=st.just(AT)),
    st.builds(Based, tab=tabs, episode=episodes, at=st.just(AT), revision=st.integers(1, 4),
              submitted=st.booleans()),
)  # fmt: skip


def chosen(name: str, tab: str = "t1") -> Chosen:
    return Chosen(tab=tab, episode="000001", at=AT, selection=(("pick", name),))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(st.lists(records, max_size=15))
def test_replaying_gives_what_was_in_memory(
    tmp_path_factory: object, written: list[Record]
) -> None:
    run: Path = tmp_path_factory.mktemp("run")  # type: ignore[attr-defined]
    journal = Journal(run, "ada")
    for record in written:
        journal.write(record)
    journal.close()
    again = Journal(run, "ada")
    assert again.entries == journal.entries and list(again.last) == list(journal.last)
    assert again.dropped == 0
    again.close()


def test_a_torn_last_line_costs_only_itself(tmp_path: Path) -> None:
    journal = Journal(tmp_path, "ada")
    journal.write(chosen("a"))
    journal.write(chosen("b"))
    journal.close()
    raw = journal.path.read_bytes()
    journal.path.write_bytes(raw[:-20])
    again = Journal(tmp_path, "ada")
    assert again.dropped == 1
    assert again.entries["t1", "000001"].draft.selection == (("pick", "a"),)
    again.write(chosen("c"))
    again.close()
    third = Journal(tmp_path, "ada")
    assert third.entries["t1", "000001"].draft.selection == (("pick", "c"),)
    third.close()


def test_a_tab_takes_over_the_draft_of_another_with_its_steps(tmp_path: Path) -> None:
    journal = Journal(tmp_path, "ada")
    for name in "ab":
        journal.write(chosen(name))
    entry = journal.write(Opened(tab="t2", episode="000001", at=AT, goes_on_from="t1"))
    assert entry.draft.selection == (("pick", "b"),)
    assert entry.draft.undo().undo().selection == ()
    assert journal.latest("000001") == ("t2", entry)
    journal.close()


def test_operators_have_files_of_their_own_whatever_their_names(tmp_path: Path) -> None:
    names = ["ada", "Ada ", "../../etc/passwd", "<b>x</b>", "名前", "名字", "a" * 300]
    paths = set()
    for name in names:
        journal = Journal(tmp_path, name)
        paths.add(journal.path)
        assert journal.path.parent == tmp_path / "labeling" / "drafts"
        journal.close()
    assert len(paths) == len(names)
