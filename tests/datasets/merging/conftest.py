"""Datasets with pictures, written by LeRobot itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def make_video_dataset() -> Callable[..., Path]:
    """Write two episodes of five frames whose pictures tell dataset, episode and frame apart."""

    def provide(root: Path, shade: int) -> Path:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        features = {
            "observation.images.cam": {
                "dtype": "video", "shape": (32, 48, 3), "names": ["height", "width", "channels"],
            },
            "observation.state": {"dtype": "float32", "shape": (2,), "names": ["a", "b"]},
            "action": {"dtype": "float32", "shape": (2,), "names": ["a", "b"]},
        }  # fmt: skip
        dataset = LeRobotDataset.create("t/v", 10, features, root=root, vcodec="h264")
        for episode in range(2):
            for frame in range(5):
                value = 60 * shade + 30 * episode + 3 * frame
                dataset.add_frame(
                    {
                        "observation.images.cam": np.full((32, 48, 3), value, np.uint8),
                        "observation.state": np.array([episode, frame], np.float32),
                        "action": np.array([frame, shade], np.float32),
                        "task": f"task {shade}",
                    }
                )
            dataset.save_episode()
        dataset.finalize()
        return root

    return provide
