"""Attention on pictures: what is seen is marked, what is hidden or outside is not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import ShapeError
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.attention_2d import attention_mask, role_masks
from codediffuser.labeling.auto import label_run
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.store import load_labels

K = np.array([[100.0, 0, 15.5], [0, 100.0, 11.5], [0, 0, 1]])
CAMERA = Camera(K, np.eye(4), 32, 24)


def at_pixel(column: float, row: float, z: float = 1.0) -> np.ndarray:
    return np.array([[(column - 15.5) / 100 * z, (row - 11.5) / 100 * z, z]])


def test_a_point_marks_its_pixel() -> None:
    mask = attention_mask(at_pixel(7, 5), CAMERA, dilation_px=0)
    assert mask.shape == (24, 32) and mask.dtype == bool
    assert np.argwhere(mask).tolist() == [[5, 7]]


@pytest.mark.parametrize("column", [-0.6, 31.6, -1e9, 1e12])
def test_points_beside_the_picture_are_dropped_not_clamped(column: float) -> None:
    assert not attention_mask(at_pixel(column, 5), CAMERA).any()


def test_points_behind_the_camera_are_dropped() -> None:
    assert not attention_mask(at_pixel(7, 5, z=-1.0), CAMERA).any()
    assert not attention_mask(np.zeros((1, 3)), CAMERA).any()


def test_no_points_give_an_empty_mask() -> None:
    assert not attention_mask(np.zeros((0, 3)), CAMERA).any()


@pytest.mark.parametrize(
    ("reading_m", "seen"), [(0.5, False), (0.98, False), (0.99, True), (1.5, True), (0.0, True)]
)
def test_a_nearer_reading_hides_a_point(reading_m: float, seen: bool) -> None:
    depth = np.full((24, 32), reading_m, np.float32)
    assert attention_mask(at_pixel(7, 5), CAMERA, depth, tolerance_m=0.015).any() == seen


def test_dilation_is_a_disc_of_its_radius() -> None:
    mask = attention_mask(at_pixel(15, 12), CAMERA, dilation_px=4)
    row, column = np.nonzero(mask)
    assert np.hypot(row - 12, column - 15).max() == 4
    assert mask.sum() == 49


def test_depth_of_another_size_is_an_error() -> None:
    with pytest.raises(ShapeError, match=r"expected \(24, 32\) as the camera says"):
        attention_mask(at_pixel(7, 5), CAMERA, np.ones((24, 31), np.float32))


def test_masks_follow_the_carried_object(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    folder = write_battery_episode(tmp_path)
    assert not [result for result in label_run(tmp_path) if result.error]
    episode, labels = Episode.open(folder), load_labels(folder).labels
    motion = RecordedMotion(episode, labels)
    field = AttentionField(labels, motion.at(0))
    name, camera = next(iter(episode.cameras.items()))
    centres = []
    for frame in episode.frames([name], color=False):
        carried = field.carried(motion.at(frame.index))
        pick, place = role_masks(*carried, camera, frame.depth_m[name])
        assert pick.any() and place.any()
        assert pick.mean() < 0.2 and place.mean() < 0.2
        centres.append(np.argwhere(pick).mean(axis=0))
    assert np.linalg.norm(centres[-1] - centres[0]) > 3
