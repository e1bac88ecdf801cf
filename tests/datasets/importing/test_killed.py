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
print("ready", flush=True)
for _ in import_recordings(source, ImportConfig.load(config), run): pass
"""


@pytest.mark.slow
def test_killed_imports_end_equal(tmp_path, python):
    source = make_bag(tmp_path / "bag.mcap", 1, episodes=6, size=(96, 72))
    config = bag_config(30)
    config.save(tmp_path / "import.yaml")
    start = time.monotonic()
    for _ in import_recordings(source, config, tmp_path / "whole"):
        pass
    whole_s = time.monotonic() - start
    expected, moments = contents(tmp_path / "whole"), random.Random(4)
    run = tmp_path / "cut"
    partials = 0
    arguments = [python, "-c", SCRIPT, str(source), str(tmp_path / "import.yaml"), str(run)]
    for _ in range(3):
        process = subprocess.Popen(arguments, stdout=subprocess.PIPE)
        assert process.stdout.readline() == b"ready\n"
        time.sleep(moments.uniform(0, whole_s / 2))
        process.kill()
        process.wait()
        partials += len(list(run.rglob(f"{TEMPORARY_PREFIX}*")))
    for _ in import_recordings(source, config, run):
        pass
    assert partials > 0
    assert contents(run) == expected


@pytest.mark.slow
def test_workers_change_nothing(tmp_path):
    source = make_bag(tmp_path / "bag.mcap", 1, episodes=3, size=(32, 24))
    for name, workers in (("one", 1), ("two", 2)):
        for _ in import_recordings(source, bag_config(10), tmp_path / name, workers=workers):
            pass
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
