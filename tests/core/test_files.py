import errno
import hashlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from codediffuser.errors import StorageError
from codediffuser.files import (
    RETIRED_PREFIX,
    TEMPORARY_PREFIX,
    atomic_folder,
    atomic_path,
    cache_folder,
    remove_partials,
    sha256_file,
    sha256_json,
    write_json,
    write_text,
)

DEAD_PID = 2**22 + 1
"""Above the largest process id that Linux gives."""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_whole_and_alone_after_writing(tmp_path: Path) -> None:
    write_text(tmp_path / "deep" / "a.txt", "ä")
    assert (tmp_path / "deep" / "a.txt").read_text() == "ä"
    assert names(tmp_path / "deep") == ["a.txt"]


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(KeyboardInterrupt), atomic_path(path) as partial:
        partial.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_the_suffix_is_kept_for_writers_that_choose_a_format_by_it(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a.npz") as partial:
        assert partial.suffix == ".npz"
        partial.touch()


def test_a_folder_takes_the_place_of_the_old_one_as_a_whole(tmp_path: Path) -> None:
    for content in ("old", "new"):
        with atomic_folder(tmp_path / "run") as partial:
            (partial / content).write_text(content)
    assert names(tmp_path / "run") == ["new"]
    assert names(tmp_path) == ["run"]


def test_a_failed_folder_leaves_the_old_one(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "run") as partial:
        (partial / "old").touch()
    with pytest.raises(RuntimeError), atomic_folder(tmp_path / "run") as partial:
        (partial / "half").touch()
        raise RuntimeError
    assert names(tmp_path / "run") == ["old"]
    assert names(tmp_path) == ["run"]


KILLED_WRITER = """
import os, signal, sys
from pathlib import Path
from codediffuser.files import atomic_folder
with atomic_folder(Path(sys.argv[1])) as partial:
    (partial / "half").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_writer_leaves_only_what_is_then_removed(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED_WRITER, str(tmp_path / "run")], check=False)
    assert done.returncode == -signal.SIGKILL
    assert not (tmp_path / "run").exists()
    assert len(names(tmp_path)) == 1
    assert remove_partials(tmp_path)[0].startswith(TEMPORARY_PREFIX)
    assert names(tmp_path) == []


def test_a_folder_killed_while_it_was_replaced_comes_back(
    tmp_path: Path,
) -> None:
    old = tmp_path / f"{RETIRED_PREFIX}{DEAD_PID}-run"
    old.mkdir()
    (old / "old").touch()
    (tmp_path / f"{TEMPORARY_PREFIX}{DEAD_PID}-run").mkdir()
    remove_partials(tmp_path)
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == ["old"]


def test_a_folder_whose_successor_arrived_does_not_come_back(tmp_path: Path) -> None:
    (tmp_path / f"{RETIRED_PREFIX}{DEAD_PID}-run").mkdir()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "new").touch()
    remove_partials(tmp_path)
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == ["new"]


def test_what_a_living_process_writes_is_left_alone(tmp_path: Path) -> None:
    alive = f"{TEMPORARY_PREFIX}{os.getppid()}-a"
    dead = f"{TEMPORARY_PREFIX}{DEAD_PID}-b"
    for name in (alive, dead, "c"):
        (tmp_path / name).mkdir()
    assert remove_partials(tmp_path) == [dead]
    assert names(tmp_path) == [alive, "c"]


def test_json_hashes_do_not_depend_on_the_order_of_keys() -> None:
    assert sha256_json({"a": 1, "b": [2]}) == sha256_json({"b": [2], "a": 1})
    assert sha256_json({"a": 1}) != sha256_json({"a": 2})


def test_a_files_hash_is_that_of_its_bytes(tmp_path: Path) -> None:
    data = b"x" * (3 << 20)
    (tmp_path / "a").write_bytes(data)
    assert sha256_file(tmp_path / "a") == hashlib.sha256(data).hexdigest()


def test_json_ends_with_a_line_break_and_keeps_letters(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"name": "ä"})
    assert (tmp_path / "a.json").read_text() == '{\n  "name": "ä"\n}\n'


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"CODEDIFFUSER_CACHE": "/own", "XDG_CACHE_HOME": "/xdg"}, "/own"),
        ({"XDG_CACHE_HOME": "/xdg"}, "/xdg/codediffuser"),
        ({"HOME": "/someone"}, "/someone/.cache/codediffuser"),
    ],
)
def test_the_cache_is_where_the_user_wants_it(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], expected: str
) -> None:
    for name in ("CODEDIFFUSER_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert cache_folder() == Path(expected)


def test_what_another_machine_writes_is_left_alone_until_it_is_old(tmp_path: Path) -> None:
    fresh, old = (tmp_path / f"{TEMPORARY_PREFIX}{os.getpid()}@elsewhere-{n}" for n in "ab")
    fresh.mkdir()
    old.mkdir()
    os.utime(old, (0, 0))
    assert remove_partials(tmp_path) == [old.name]
    assert remove_partials(tmp_path, names=["b"]) == []
    assert remove_partials(tmp_path, names=["a"]) == [fresh.name]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_one_error_that_names_the_file(tmp_path: Path, number: int) -> None:
    path = tmp_path / "run" / "a.txt"
    with (
        pytest.raises(StorageError, match=rf"{path}: .*; make room on that disk"),
        atomic_path(path) as partial,
    ):
        partial.write_text("half")
        raise OSError(number, "full")
    assert names(tmp_path / "run") == []


def test_other_errors_of_the_disk_stay_what_they_are(tmp_path: Path) -> None:
    with pytest.raises(PermissionError), atomic_folder(tmp_path / "run"):
        raise PermissionError(errno.EACCES, "no")
