"""A lease is given to one tab, runs out, and is never worth a crash."""

from __future__ import annotations

from pathlib import Path

from codediffuser.labeling.leases import LEASE_S, LEASES, LeaseBook


def test_one_holder_at_a_time(tmp_path: Path) -> None:
    mine, yours = LeaseBook(tmp_path), LeaseBook(tmp_path)
    assert mine.claim(["a", "b"], "tab1", "ada") == "a"
    assert yours.claim(["a", "b"], "tab2", "bob") == "b"
    assert yours.claim(["a"], "tab2", "bob") is None
    assert yours.other("a", "tab2") == "ada" and mine.other("a", "tab1") is None


def test_claiming_another_gives_the_first_back(tmp_path: Path) -> None:
    book = LeaseBook(tmp_path)
    book.claim(["a"], "tab1", "ada")
    book.claim(["b"], "tab1", "ada")
    assert book.claim(["a"], "tab2", "bob") == "a"


def test_a_lease_that_nobody_renews_is_free(tmp_path: Path) -> None:
    now = [0.0]
    book = LeaseBook(tmp_path, lambda: now[0])
    book.claim(["a"], "tab1", "ada")
    now[0] = LEASE_S - 1
    book.renew("tab1")
    now[0] = LEASE_S + 1
    assert book.claim(["a"], "tab2", "bob") is None
    now[0] = 2 * LEASE_S
    assert book.claim(["a"], "tab2", "bob") == "a"


def test_release_gives_everything_back(tmp_path: Path) -> None:
    book = LeaseBook(tmp_path)
    book.claim(["a"], "tab1", "ada")
    book.release("tab1")
    assert book.other("a", "tab2") is None


def test_a_broken_file_means_no_leases(tmp_path: Path) -> None:
    book = LeaseBook(tmp_path)
    book.claim(["a"], "tab1", "ada")
    (tmp_path / "labeling" / LEASES).write_text("{")
    assert book.claim(["a"], "tab2", "bob") == "a"
