"""At the rate of the cameras an import takes every picture, each exactly once."""

import numpy as np

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.episode_format import SYNC
from codediffuser.datasets.importing.big_bag import CAMERA_HZ, CAMERAS, bag_config, make_bag
from codediffuser.datasets.importing.config import ImportConfig


def test_every_picture_is_taken_once(tmp_path, run_import):
    source = make_bag(tmp_path / "bag.mcap", 1, episodes=2, size=(32, 24))
    raw = bag_config(CAMERA_HZ).model_dump(mode="json", by_alias=True)
    raw["sync"]["reference"] = "/front/image_raw"
    run, results = run_import(source, ImportConfig.parse(raw, "config"))
    assert [r.outcome for r in results] == ["imported"] * 2, [r.reason for r in results]
    for folder in list_episodes(run):
        # One second each; the last frame has no next state to act towards.
        assert Episode.open(folder).num_frames == CAMERA_HZ - 1
        with np.load(folder / SYNC) as sync:
            pictures = [times for name, times in sync.items() if "color" in name]
        assert len(pictures) == len(CAMERAS)
        for times in pictures:
            assert np.all(np.abs(np.diff(times) - 1e9 / CAMERA_HZ) <= 1)
