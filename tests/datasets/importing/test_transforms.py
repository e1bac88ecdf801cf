"""Poses through a tree of static and moving frames."""

import numpy as np
import pytest

from codediffuser.datasets.importing.transforms import TransformTree
from codediffuser.errors import DatasetError
from codediffuser.poses import make_transform, rotation_z


def shift(x):
    return make_transform(np.eye(3), np.array([x, 0.0, 0.0]))


TURN = make_transform(rotation_z(np.pi / 2), np.zeros(3))


@pytest.fixture
def tree():
    moving = [("base", "hand", t, shift(t / 10)) for t in (20, 0, 10)]
    static = [("world", "base", shift(1)), ("hand", "camera", TURN), ("world", "mast", shift(5))]
    return TransformTree(static, moving)


def test_a_pose_is_the_product_along_the_way(tree):
    pose = tree.lookup("world", "camera", 10)
    assert np.allclose(pose.T, shift(2) @ TURN) and pose.time_ns == 10 and pose.moving


def test_the_latest_transform_before_the_moment_counts(tree):
    assert tree.lookup("world", "hand", 19).time_ns == 10
    with pytest.raises(DatasetError, match="only after the moment"):
        tree.lookup("world", "hand", -1)


def test_static_frames_have_no_time(tree):
    pose = tree.lookup("world", "mast", 0)
    assert pose.time_ns is None and not pose.moving
    assert not tree.is_moving("world", "mast") and tree.is_moving("mast", "camera")


def test_any_frame_may_be_the_world(tree):
    for a, b in (("mast", "camera"), ("camera", "mast"), ("hand", "world")):
        forth, back = tree.lookup(a, b, 20).T, tree.lookup(b, a, 20).T
        assert np.allclose(forth @ back, np.eye(4))


def test_frames_that_are_not_connected_are_told(tree):
    with pytest.raises(DatasetError, match="do not connect 'moon' with the world frame 'world'"):
        tree.lookup("world", "moon", 0)
