"""Scenes per second with and without pictures: `python -m codediffuser.datagen.sheets.bench`.

One process; times are those of the processor, so that other work on the machine counts little.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from pathlib import Path

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene_files import sample_scenes
from codediffuser.datagen.scene_sampler import SceneSource
from codediffuser.datagen.task import TASKS, get_task


def scenes_per_second(task_name: str, variant: str, count: int, *, pictures: bool) -> float:
    """Draw and write `count` scenes into a temporary folder; the first one is not timed.

    With pictures, this includes those of the whole set.
    """
    source = SceneSource(get_task(task_name), SamplingSettings(root_seed=0, variant=variant))
    with tempfile.TemporaryDirectory() as folder:
        scenes = sample_scenes(source, Path(folder), count + 1, pictures=pictures)
        next(scenes)
        started = time.process_time()
        for _ in scenes:
            pass
        return count / (time.process_time() - started)


def main() -> None:
    """Print a table of all tasks and variants."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", "--num-scenes", type=int, default=200, help="per task and variant")
    count = parser.parse_args().num_scenes
    sys.stdout.write("task variant: scenes/s without, with pictures\n")
    for name, variant in itertools.product(TASKS.names(), ("sim", "real")):
        without, drawn = (
            scenes_per_second(name, variant, count, pictures=pictures) for pictures in (False, True)
        )
        sys.stdout.write(f"{name} {variant}: {without:.0f}, {drawn:.1f}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
