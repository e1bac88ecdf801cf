"""Killed with signal 9 at random moments and run again, an import ends as if left alone."""

import random
import subprocess
import time

import pytest

from codediffuser.datasets.importing.bench import contents
from codediffuser.datasets.importing.big_bag import bag_config, make_bag
from codediffuser.datasets.importing.run import import_recordings
from codediffuser.files import TEMPORARY_PREFIX

SCRIPT = """
import sys
from pathlib import Path
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.run import import_recordings
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
def test_workers_change_nothing(tmp_path):
    source = make_bag(tmp_path / "bag.mcap", 1, episodes=3, size=(32, 24))
    for name, workers in (("one", 1), ("two", 2)):
        for _ in import_recordings(source, bag_config(10), tmp_path / name, workers=workers):
            pass
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
