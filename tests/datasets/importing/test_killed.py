"""Killed with signal 9 at random moments and run again, an import ends as if left alone."""

import random
import subprocess
import time

import pytest

from codediffuser.datasets.importing.big_bag import bag_config, make_bag
from codediffuser.datasets.importing.run import REPORT, ImportReport, import_recordings
from codediffuser.datasets.kill_drill import run_contents as contents
from codediffuser.files import TEMPORARY_PREFIX

SCRIPT = """
import sys
from pathlib import Path
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.run import REPORT, ImportReport, import_recordings
source, config, run = map(Path, sys.argv[1:])
for _ in import_recordings(source, ImportConfig.load(config), run): pass
"""


@pytest.mark.slow
def test_killed_imports_end_equal(tmp_path, python):
    source = make_bag(tmp_path / "bag.mcap", 1, episodes=6, size=(96, 72))
    config = bag_config(30)
    config.save(tmp_path / "import.yaml")
    for _ in import_recordings(source, config, tmp_path / "whole"):
        pass
    moments, run = random.Random(4), tmp_path / "cut"
    arguments = [python, "-c", SCRIPT, str(source), str(tmp_path / "import.yaml"), str(run)]
    at_work = 0
    for _ in range(3):
        process = subprocess.Popen(arguments)
        # Imports are killed while they write, at a random moment of it.
        while process.poll() is None and not list(run.rglob(f"{TEMPORARY_PREFIX}*/*")):
            time.sleep(0.01)
        time.sleep(moments.uniform(0, 0.1))
        at_work += process.poll() is None
        process.kill()
        process.wait()
    assert at_work > 0
    for _ in import_recordings(source, config, run):
        pass
    assert contents(run) == contents(tmp_path / "whole")


@pytest.mark.slow
def test_several_bags_at_once_give_what_one_after_the_other_gives(tmp_path):
    for number in (9, 10):
        make_bag(
            tmp_path / "bags" / f"bag_{number}.mcap", 1, episodes=2, seed=number, size=(32, 24)
        )
    for name, workers in (("one", 1), ("two", 2)):
        run = tmp_path / name
        imported = import_recordings(tmp_path / "bags", bag_config(10), run, workers=workers)
        assert [r.outcome for r in imported] == ["imported"] * 4
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    report = ImportReport.load(tmp_path / "two" / REPORT)
    assert [e.recording for e in report.episodes] == [
        "bag_9.mcap#0", "bag_9.mcap#1", "bag_10.mcap#0", "bag_10.mcap#1",
    ]  # fmt: skip
