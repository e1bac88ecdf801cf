"""`demo` with a full disk, Ctrl-C and hung scenes: one clear message, and whole files only."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from codediffuser.datagen.collect import CollectOptions, collect_demos
from codediffuser.datagen.scene import scene_path
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.files import TEMPORARY_PREFIX

DEMO = [sys.executable, "-m", "codediffuser.cli", "demo"]


def write_scenes(run: Path, count: int) -> None:
    for index in range(count):
        scene = sample_scene(get_task("pack_battery"), root_seed=3, index=index)
        scene.save(scene_path(run, scene.scene_id))


def leftovers(run: Path) -> list[Path]:
    return list(run.rglob(f"{TEMPORARY_PREFIX}*"))


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[None]:
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
        capture_output=True, check=False,
    )  # fmt: skip
    if mounted.returncode:
        pytest.skip("only an administrator may mount a small disk")
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.slow
def test_a_full_disk_is_one_error_and_leaves_whole_files_only(tmp_path: Path) -> None:
    run = tmp_path / "disk"
    with small_disk(run, "120k"):
        write_scenes(run, 3)
        done = subprocess.run(
            [*DEMO, str(run), "--physics-only"], capture_output=True, text=True, check=False
        )
        assert done.returncode == 2, done.stderr
        told = [line for line in done.stderr.splitlines() if "StorageError" in line]
        assert len(told) == 1
        assert "no space left on device; make room on that disk" in told[0]
        assert "Traceback" not in done.stderr
        assert leftovers(run) == []
        for states in run.glob("physics/0*"):
            assert {p.name for p in states.iterdir()} == {"states.npz", "physics.json"}


@pytest.mark.slow
def test_ctrl_c_says_how_to_go_on_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    write_scenes(tmp_path, 20)  # enough that it cannot be done before the signal comes
    process = subprocess.Popen(
        [*DEMO, str(tmp_path), "--physics-only"],
        stderr=subprocess.PIPE, text=True, start_new_session=True,
        # Whoever started the tests in the background lets every child ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    deadline = time.monotonic() + 300
    while not list(tmp_path.glob("physics/0*")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, told = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Interrupted. What is written is whole; run the same command to continue." in told
    assert leftovers(tmp_path) == []


@pytest.mark.slow
def test_a_hung_scene_is_a_counted_failure_and_its_process_is_replaced(tmp_path: Path) -> None:
    write_scenes(tmp_path, 1)
    # No scene is done in a millisecond, so every one hangs by this measure.
    options = CollectOptions(physics_only=True, timeout_s=0.001)
    (result,) = collect_demos(tmp_path, options)
    assert (result.success, result.phase, result.tries) == (False, "process:hung", 2)
    assert "no answer within 0 s, killed" in result.reason
    (again,) = collect_demos(tmp_path, CollectOptions(physics_only=True))
    assert again.success
