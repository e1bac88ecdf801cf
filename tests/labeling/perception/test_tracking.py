from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.task import get_task
from codediffuser.errors import LabelError
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.auto import start_cloud
from codediffuser.labeling.ground_truth import ground_truth_labels
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.perception.finding import FoundInstance
from codediffuser.labeling.perception.fitting import evidence, fit_rigid
from codediffuser.labeling.perception.tracking import Tracker, track_object
from codediffuser.labeling.perception.views import View
from codediffuser.pointcloud import backproject_depth
from codediffuser.poses import apply_transform, invert_transform, make_transform

MakeViews = Callable[..., tuple[View, ...]]


@pytest.fixture
def box(make_views: MakeViews) -> tuple[tuple[View, ...], np.ndarray]:
    """Three views of a box, and the points that they read of it."""
    views = make_views(3)
    clouds = [backproject_depth(v.depth_m, v.camera.K, v.camera.T_world_camera)[0] for v in views]
    cloud = np.concatenate(clouds)
    return views, cloud[cloud[:, 2] > 0.005].astype(np.float64)


def test_cameras_confirm_points_where_they_are(box: tuple[tuple[View, ...], np.ndarray]) -> None:
    views, points = box
    assert evidence(points, views).confidence == 1.0


def test_points_in_the_air_are_missing(box: tuple[tuple[View, ...], np.ndarray]) -> None:
    views, points = box
    lifted = evidence(points + np.array([0.0, 0.0, 0.15]), views)
    assert lifted.missing > 0.9
    assert lifted.confidence < 0.1


def test_points_inside_the_table_are_confirmed_by_nobody(
    box: tuple[tuple[View, ...], np.ndarray],
) -> None:
    views, points = box
    sunk = evidence(points - np.array([0.0, 0.0, 0.15]), views)
    assert sunk.missing == 0.0
    assert sunk.confidence < 0.1


def test_fitting_brings_points_back(box: tuple[tuple[View, ...], np.ndarray]) -> None:
    _, cloud = box
    T = make_transform(
        Rotation.from_rotvec([0.1, -0.05, 0.15]).as_matrix(), np.array([5e-3, 0, 3e-3])
    )
    moved = apply_transform(T, cloud)
    fitted = fit_rigid(moved, cKDTree(cloud), np.eye(4))
    before = np.linalg.norm(moved - cloud, axis=1).mean()
    after = np.linalg.norm(apply_transform(fitted, moved) - cloud, axis=1).mean()
    assert after < before / 4


def test_a_carried_object_is_followed_without_its_poses(
    write_battery_episode: Callable[..., Path], tmp_path: Path
) -> None:
    episode = Episode.open(write_battery_episode(tmp_path, num_steps=12))
    task, trajectory = get_task(episode.scene.task), episode.trajectory
    T_start = {"battery_0": trajectory.T_world_object("battery_0", 0)}
    label, _ = ground_truth_labels(task, episode.scene, T_start, start_cloud(episode, task))
    track = track_object(episode, label.points_world)
    for k in range(episode.num_frames):
        T = trajectory.T_world_object("battery_0", k) @ invert_transform(T_start["battery_0"])
        off = track.T_now_start[k][:3, 3] - T[:3, 3]
        assert np.linalg.norm(off) < 0.005, k
    assert track.held.all()
    assert track.T_now_start.shape == (episode.num_frames, 4, 4)


def test_a_found_object_moves_by_its_track(
    write_battery_episode: Callable[..., Path], tmp_path: Path
) -> None:
    episode = Episode.open(write_battery_episode(tmp_path, num_steps=12))
    task, trajectory = get_task(episode.scene.task), episode.trajectory
    T_start = {"battery_0": trajectory.T_world_object("battery_0", 0)}
    true, _ = ground_truth_labels(task, episode.scene, T_start, start_cloud(episode, task))
    found = replace(true, instance_id="found_battery_0", follows="found_battery_0")
    motion = RecordedMotion(episode, [found])
    expected = RecordedMotion(episode, [true])
    for k in (0, 5, 11):
        field, carried = AttentionField([found], motion.at(0)), motion.at(k)
        points, _ = field.carried(carried)
        truth, _ = AttentionField([true], expected.at(0)).carried(expected.at(k))
        np.testing.assert_allclose(points, truth, atol=0.005)
        assert motion.confidence(k) > 0.5
    assert expected.confidence(5) == 1.0


def shifted(views: tuple[View, ...], by_m: np.ndarray) -> tuple[View, ...]:
    """The same views of a world that is moved as a whole."""
    move = make_transform(np.eye(3), by_m)
    return tuple(
        replace(v, camera=replace(v.camera, T_world_camera=move @ v.camera.T_world_camera))
        for v in views
    )


FAR_HAND = make_transform(np.eye(3), np.array([0.0, 0.0, 5.0]))


def test_an_object_that_is_pushed_is_followed(box: tuple[tuple[View, ...], np.ndarray]) -> None:
    views, points = box
    tracker = Tracker(points, None)
    for k in range(12):
        tracker.step(shifted(views, np.array([0.004 * k, 0.0, 0.0])), FAR_HAND, 0.04)
    np.testing.assert_allclose(tracker.T_now_start[:3, 3], [0.044, 0.0, 0.0], atol=0.003)
    assert tracker.confidence > 0.9


def test_a_lost_object_is_found_among_the_instances_of_its_category(
    box: tuple[tuple[View, ...], np.ndarray],
) -> None:
    views, points = box
    by_m = np.array([0.0, 0.12, 0.0])
    there = (points + by_m).astype(np.float32)
    found = FoundInstance("mug", there, np.zeros((len(there), 3), np.uint8), by_m, 1.0)
    tracker = Tracker(points, lambda views: [found])
    tracker.step(views, FAR_HAND, 0.04)
    tracker.step(shifted(views, by_m), FAR_HAND, 0.04)
    np.testing.assert_allclose(tracker.T_now_start[:3, 3], by_m, atol=0.003)


def test_an_object_that_nothing_shows_stays_where_it_was(
    box: tuple[tuple[View, ...], np.ndarray],
) -> None:
    views, points = box
    tracker = Tracker(points, None)
    tracker.step(views, FAR_HAND, 0.04)
    blind = tuple(replace(v, depth_m=np.zeros_like(v.depth_m)) for v in views)
    for _ in range(5):
        tracker.step(blind, FAR_HAND, 0.04)
    np.testing.assert_array_equal(tracker.T_now_start, np.eye(4))
    assert tracker.confidence == 0.0


def test_an_object_without_points_is_refused(
    write_battery_episode: Callable[..., Path], tmp_path: Path
) -> None:
    episode = Episode.open(write_battery_episode(tmp_path))
    with pytest.raises(LabelError, match="without points"):
        track_object(episode, np.zeros((0, 3), np.float32))
