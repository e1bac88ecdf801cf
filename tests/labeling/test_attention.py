"""Attention of labelled points, carried by the motion of what they belong to."""

from __future__ import annotations

import time

import numpy as np
import pytest

from codediffuser.errors import LabelError, ShapeError
from codediffuser.labeling.attention import (
    AttentionField,
    attention_at,
    clean_attention,
    corrupt_attention,
)
from codediffuser.labeling.label import AttentionLabel, Provenance
from codediffuser.poses import apply_transform, make_transform, rotation_z

BY = Provenance(source="simulator", labeler="test", tool_version="0")
START = {"mug": make_transform(rotation_z(0.3), np.array([0.1, 0.0, 0.02]))}


def blob(center: tuple[float, float, float], count: int = 200, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (np.array(center) + rng.uniform(-0.015, 0.015, (count, 3))).astype(np.float32)


def label(role: str, points: np.ndarray, follows: str | None = None) -> AttentionLabel:
    return AttentionLabel(role, role, f"{role}_0", points, follows, BY)  # type: ignore[arg-type]


@pytest.fixture
def field() -> AttentionField:
    labels = [label("pick", blob((0.1, 0, 0.05)), "mug"), label("place", blob((-0.1, 0.2, 0.02)))]
    return AttentionField(labels, START)


def test_frame_0_attends_to_labelled_points_by_role(field: AttentionField) -> None:
    pick, place = (x.points_world for x in field.labels)
    far = blob((0, 0, 0.4))
    attention = field.at(np.concatenate([pick, place, far]), START)
    assert attention.dtype == np.float32
    assert attention.sum(axis=0).tolist() == [200, 200]
    assert attention[:200, 0].all() and attention[200:400, 1].all()


def test_attention_follows_a_moved_and_turned_object(field: AttentionField) -> None:
    now = {"mug": make_transform(rotation_z(2.0), np.array([0.0, 0.1, 0.3]))}
    motion = now["mug"] @ np.linalg.inv(START["mug"])
    moved = apply_transform(motion, field.labels[0].points_world)
    assert field.at(moved, now)[:, 0].all()
    assert not field.at(field.labels[0].points_world, now)[:, 0].any()


def test_attention_of_a_place_stands_still(field: AttentionField) -> None:
    now = {"mug": make_transform(np.eye(3), np.array([1.0, 1.0, 1.0]))}
    assert field.at(field.labels[1].points_world, now)[:, 1].all()


def test_moving_everything_together_changes_nothing(field: AttentionField) -> None:
    rng = np.random.default_rng(1)
    cloud = np.concatenate([blob((0.1, 0, 0.05), seed=7), blob((0.13, 0, 0.05), seed=8)])
    before = field.at(cloud, START)[:, 0]
    motion = make_transform(rotation_z(1.0), rng.uniform(-0.2, 0.2, 3))
    after = field.at(apply_transform(motion, cloud), {"mug": motion @ START["mug"]})[:, 0]
    assert 0 < before.sum() < len(cloud)
    # Points on the very edge of the radius may change sides by rounding.
    assert (before != after).mean() < 0.01


def test_radius_bounds_attention() -> None:
    one = label("pick", np.zeros((1, 3), np.float32))
    cloud = np.array([[0.0049, 0, 0], [0.0051, 0, 0]], np.float32)
    assert attention_at(cloud, [one], {}, {}, radius_m=0.005)[:, 0].tolist() == [1, 0]


def test_carried_points_are_attended_where_they_are(field: AttentionField) -> None:
    now = {"mug": make_transform(rotation_z(-1.0), np.array([0.2, -0.1, 0.2]))}
    points, attention = field.carried(now)
    assert np.array_equal(attention, field.at(points, now))


def test_an_empty_cloud_has_no_attention(field: AttentionField) -> None:
    assert field.at(np.zeros((0, 3), np.float32), START).shape == (0, 2)


def test_missing_pose_names_the_object_and_those_known(field: AttentionField) -> None:
    with pytest.raises(LabelError, match=r"follows 'mug', which has no pose now.*there for: cup"):
        field.at(blob((0, 0, 0)), {"cup": np.eye(4)})
    with pytest.raises(LabelError, match="no pose at frame 0"):
        AttentionField([label("pick", blob((0, 0, 0)), "mug")], {})


def test_a_label_without_points_is_refused() -> None:
    with pytest.raises(LabelError, match="pick_0' has no points"):
        AttentionField([label("pick", np.zeros((0, 3), np.float32))], {})


def test_wrong_shapes_are_refused(field: AttentionField) -> None:
    with pytest.raises(ShapeError, match="points_world"):
        field.at(np.zeros((5, 2), np.float32), START)
    with pytest.raises(ShapeError, match="attention"):
        clean_attention(blob((0, 0, 0)), np.zeros((3, 2), np.float32))


def test_20000_points_take_less_than_10_ms(field: AttentionField) -> None:
    rng = np.random.default_rng(0)
    cloud = rng.uniform([-0.2, -0.2, 0], [0.2, 0.3, 0.4], (20_000, 3)).astype(np.float32)
    used = []
    for _ in range(5):
        start = time.process_time()
        field.at(cloud, START)
        used.append(time.process_time() - start)
    assert min(used) < 0.010


# Cleaning and the stress test.


@pytest.fixture
def scene() -> tuple[np.ndarray, np.ndarray]:
    """A workspace of 6000 points, two compact targets in it, and their true attention."""
    rng = np.random.default_rng(3)
    rest = rng.uniform([-0.2, -0.2, 0], [0.2, 0.3, 0.08], (5500, 3)).astype(np.float32)
    points = np.concatenate([blob((0, 0, 0.04), 250, 1), blob((0.1, 0.2, 0.03), 250, 2), rest])
    attention = np.zeros((6000, 2), np.float32)
    attention[:250, 0] = attention[250:500, 1] = 1
    return points, attention


def test_corruption_swaps_the_given_share(scene: tuple[np.ndarray, np.ndarray]) -> None:
    _, attention = scene
    corrupted = corrupt_attention(attention, np.random.default_rng(0), 0.15)
    for channel in range(2):
        true, now = attention[:, channel] > 0, corrupted[:, channel] > 0
        assert now.sum() == true.sum()
        assert (true & ~now).sum() == (now & ~true).sum() == round(0.15 * 250)


def test_corruption_of_nothing_or_everything_is_safe() -> None:
    rng = np.random.default_rng(0)
    assert not corrupt_attention(np.zeros((9, 2), np.float32), rng).any()
    everything = corrupt_attention(np.ones((10, 1), np.float32), rng, 0.2)
    assert everything.sum() == 8, "no other point can gain what two points lost"


def test_cleaning_removes_nearly_all_wrong_points(scene: tuple[np.ndarray, np.ndarray]) -> None:
    points, attention = scene
    corrupted = corrupt_attention(attention, np.random.default_rng(0), 0.15)
    cleaned = clean_attention(points, corrupted)
    for channel in range(2):
        true = attention[:, channel] > 0
        before = (corrupted[~true, channel] > 0).sum()
        after = (cleaned[~true, channel] > 0).sum()
        assert before == 38 and after <= 4
        assert cleaned[true, channel].sum() >= 0.8 * true.sum()


def test_cleaning_keeps_a_clean_mask(scene: tuple[np.ndarray, np.ndarray]) -> None:
    points, attention = scene
    assert np.array_equal(clean_attention(points, attention), attention)


def test_cleaning_twice_is_cleaning_once(scene: tuple[np.ndarray, np.ndarray]) -> None:
    points, attention = scene
    for seed in range(5):
        corrupted = corrupt_attention(attention, np.random.default_rng(seed), 0.4)
        once = clean_attention(points, corrupted)
        assert np.array_equal(clean_attention(points, once), once)


def test_pieces_of_a_target_stay_and_smaller_ones_go() -> None:
    points = np.concatenate([blob((0, 0, 0), 100), blob((0.1, 0, 0), 60), blob((0.2, 0, 0), 10)])
    attention = np.ones((170, 1), np.float32)
    assert clean_attention(points, attention)[:, 0].tolist() == [1] * 160 + [0] * 10
    alone = clean_attention(points, attention, min_share=1.0)
    assert alone[:, 0].tolist() == [1] * 100 + [0] * 70


def test_a_mask_too_sparse_to_judge_is_left_alone() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0]], np.float32)
    attention = np.ones((2, 1), np.float32)
    assert np.array_equal(clean_attention(points, attention), attention)


def test_cleaning_does_not_change_its_input(scene: tuple[np.ndarray, np.ndarray]) -> None:
    points, attention = scene
    corrupted = corrupt_attention(attention, np.random.default_rng(0))
    before = corrupted.copy()
    clean_attention(points, corrupted)
    assert np.array_equal(corrupted, before)
