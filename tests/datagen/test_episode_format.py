"""Manifests of older versions are still read."""

from pathlib import Path

import pytest

from codediffuser.datagen.episode_format import EpisodeManifest, MotionRecord

SAMPLES = Path(__file__).parent.parent / "data" / "schema"


@pytest.mark.parametrize("path", sorted(SAMPLES.glob("episode-*.json")), ids=lambda p: p.name)
def test_a_manifest_of_an_older_version_is_lifted(path):
    manifest = EpisodeManifest.load(path)
    assert manifest.schema_ == "codediffuser.episode/2"
    assert manifest.recording is None and manifest.motion == MotionRecord()
    assert all(c.depth and c.calibrated and not c.moving for c in manifest.cameras)
