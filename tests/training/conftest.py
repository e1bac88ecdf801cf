"""A learnable toy: the hand goes to the pick cluster, closes, and goes on to the place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.features import ACTION, EPISODE_ID, LABELS, POINTS, STATE
from codediffuser.training.config import TrainConfig, load_preset

NUM_POINTS = 96
STEPS = 24
DOWN = np.array([1.0, 0, 0, 0, -1.0, 0], dtype=np.float32)


def toy_episode(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """One episode: points (T, N, 5), state (T, 10), action (T, 10), all float32, world."""
    pick, place, other = rng.uniform([-0.1, -0.1, 0.02], [0.1, 0.1, 0.04], size=(3, 3))
    start = np.array([0.0, 0.0, 0.3])
    share = np.clip(np.arange(STEPS + 1) / (STEPS / 2), 0, 2)[:, None]
    path = np.where(share < 1, start + share * (pick - start), pick + (share - 1) * (place - pick))
    opening = np.where(share < 1, 0.04, 0.0)
    poses = np.hstack([path, np.tile(DOWN, (STEPS + 1, 1)), opening]).astype(np.float32)
    clouds = [_toy_cloud(hand, pick, place, other, rng) for hand in poses[:-1, :3]]
    return {"points": np.stack(clouds), "state": poses[:-1], "action": poses[1:]}


def _toy_cloud(
    hand: np.ndarray, pick: np.ndarray, place: np.ndarray, other: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """(N, 5) float32: a quarter of the points each at pick, place, hand and elsewhere, shuffled."""
    quarter = NUM_POINTS // 4
    centers = np.repeat([pick, place, hand, other], quarter, axis=0)
    spread = np.repeat([0.015, 0.015, 0.03, 0.08], quarter)[:, None]
    xyz = centers + spread * rng.uniform(-1, 1, size=(NUM_POINTS, 3))
    attention = np.zeros((NUM_POINTS, 2))
    attention[:quarter, 0] = 1
    attention[quarter : 2 * quarter, 1] = 1
    cloud = np.hstack([xyz, attention]).astype(np.float32)
    return np.asarray(rng.permutation(cloud))


def write_export(root: Path, episodes: list[dict[str, np.ndarray]]) -> Path:
    """Write a LeRobot v3 dataset with flat points."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    def vector(length: int) -> dict[str, object]:
        return {"dtype": "float32", "shape": (length,), "names": [f"v{i}" for i in range(length)]}

    quarter = NUM_POINTS // 4
    cloud = CloudConfig(
        pick_points=quarter, place_points=quarter, hand_points=quarter, rest_points=quarter
    )
    points = {**vector(NUM_POINTS * 5), "names": {"cloud": cloud.model_dump(mode="json")}}
    text = {"dtype": "string", "shape": (1,), "names": None}
    features = {
        POINTS: points, STATE: vector(10), ACTION: vector(10),
        LABELS: text, EPISODE_ID: text,
    }  # fmt: skip
    dataset = LeRobotDataset.create("toy/points", 25, features, root=root, use_videos=False)
    for number, episode in enumerate(episodes):
        for t in range(STEPS):
            dataset.add_frame(
                {
                    POINTS: episode["points"][t].reshape(-1),
                    STATE: episode["state"][t],
                    ACTION: episode["action"][t],
                    LABELS: "{}",
                    EPISODE_ID: f"toy_{number}",
                    "task": "put the thing there",
                }
            )
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture(scope="session")
def toy_episodes() -> list[dict[str, np.ndarray]]:
    """Six episodes."""
    return [toy_episode(np.random.default_rng([7, i])) for i in range(6)]


@pytest.fixture(scope="session")
def toy_export(
    toy_episodes: list[dict[str, np.ndarray]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A LeRobot export of them, `RUN/lerobot`."""
    return write_export(tmp_path_factory.mktemp("toy_run") / "lerobot", toy_episodes)


@pytest.fixture(scope="session")
def tiny_config() -> TrainConfig:
    """The `cpu` preset, small enough for a test."""
    return load_preset("cpu").with_changes(
        name="tiny", steps=8, batch_size=8, log_every_steps=2, checkpoint_every_steps=4,
        validate_every_steps=4, num_threads=1, validation_share=0.2,
        policy={
            "down_dims": [16, 32], "crop_pick_points": 8, "crop_place_points": 8,
            "crop_hand_points": 8, "encoder_dim": 16, "num_inference_steps": 3,
            "scheduler_warmup_steps": 2,
        },
    )  # fmt: skip
