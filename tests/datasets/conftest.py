"""Small labelled runs and their exports, shared by the tests of this folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datasets.clouds import CloudConfig

TEXTS = ("Put the battery in the right slot.", "Pick a battery into a slot.")


@pytest.fixture
def small_config() -> CloudConfig:
    """Clouds of 40 points."""
    return CloudConfig(pick_points=16, place_points=12, hand_points=8, rest_points=4)


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., None]:
    """Make a folder on first use and copy it from then on: tests change what they get."""
    store = tmp_path_factory.mktemp("made_once")

    def provide(key: str, target: Path, make: Callable[[Path], None]) -> None:
        if not (store / key).exists():
            make(store / key)
        shutil.copytree(store / key, target)

    return provide


@pytest.fixture
def labelled_run(
    tmp_path: Path, made_once: Callable[..., None], write_battery_episode: Callable[..., Path]
) -> Callable[..., Path]:
    """Provide a run of labelled episodes whose lengths differ; returns its folder."""
    from codediffuser.labeling.auto import label_run

    def provide(count: int = 3) -> Path:
        def make(run: Path) -> None:
            for i in range(1, count + 1):
                write_battery_episode(run, f"{i:06d}", 4 + i, text=TEXTS[i % 2])
            assert not [r for r in label_run(run) if r.error]

        made_once(f"labelled_{count}", tmp_path / "run", make)
        return tmp_path / "run"

    return provide


@pytest.fixture
def exported_run(
    tmp_path: Path,
    made_once: Callable[..., None],
    labelled_run: Callable[..., Path],
    small_config: CloudConfig,
) -> Path:
    """A run of three episodes with its export in `lerobot/`."""
    from codediffuser.datasets.convert import convert_run

    def make(run: Path) -> None:
        for _ in convert_run(labelled_run(), config=small_config):
            pass
        shutil.move(tmp_path / "run", run)

    made_once("exported", tmp_path / "run", make)
    return tmp_path / "run"


@pytest.fixture
def make_video_dataset() -> Callable[..., Path]:
    """Write two episodes by LeRobot's writer; pictures tell dataset, episode and frame apart."""

    def provide(
        root: Path, shade: int = 1, frames: int = 5,
        picture: Callable[[int], np.ndarray] | None = None,
    ) -> Path:  # fmt: skip
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
            for frame in range(frames):
                value = 60 * shade + 30 * episode + 3 * frame
                shown = np.full((32, 48, 3), value, np.uint8)
                if picture is not None:
                    shown = picture(frame).astype(np.uint8)
                dataset.add_frame(
                    {
                        "observation.images.cam": shown,
                        "observation.state": np.array([episode, frame], np.float32),
                        "action": np.array([frame, shade], np.float32),
                        "task": f"task {shade}",
                    }
                )
            dataset.save_episode()
        dataset.finalize()
        return root

    return provide
