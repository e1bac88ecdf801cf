"""Manifests of older versions are still read; steps have exact times."""

from pathlib import Path

import pytest

from codediffuser.datagen.episode_format import EpisodeManifest, MotionRecord, step_time_ns

SAMPLES = Path(__file__).parent.parent / "data" / "schema"


@pytest.mark.parametrize("path", sorted(SAMPLES.glob("episode-*.json")), ids=lambda p: p.name)
def test_a_manifest_of_an_older_version_is_lifted(path):
    manifest = EpisodeManifest.load(path)
    assert manifest.schema_ == "codediffuser.episode/2"
    assert manifest.recording is None and manifest.motion == MotionRecord()
    assert all(c.depth and c.calibrated and not c.moving for c in manifest.cameras)


def test_step_times_are_rounded_to_the_nearest_nanosecond():
    assert step_time_ns(3, 25) == 120_000_000
    assert [step_time_ns(k, 30) for k in range(3)] == [0, 33_333_333, 66_666_667]
