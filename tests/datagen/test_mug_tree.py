"""The mug tree: places around branches, and how one speaks of them."""

import numpy as np
import pytest

from codediffuser.datagen.layout import Layout
from codediffuser.datagen.mug_tree import (
    TreeConfig,
    spoken,
    tree_branches,
    tree_from_above,
    tree_geometry,
    tree_object,
    tree_places,
)
from codediffuser.datagen.scene import Vector3
from codediffuser.datagen.tasks.hang_mug import HangMug
from codediffuser.errors import ConfigError
from codediffuser.schema import parse_model

NAMES = {
    "sim": ["right_topmost", "left_topmost", "right_middle", "left_middle"],
    "real": ["right", "left", "top"],
}


@pytest.fixture(scope="module")
def task() -> HangMug:
    return HangMug()


@pytest.fixture(scope="module", params=sorted(NAMES))
def tree(request: pytest.FixtureRequest, task: HangMug) -> TreeConfig:
    return task.config.variants[request.param].tree


def surface(points: int, start: np.ndarray, end: np.ndarray, radius_m: float) -> np.ndarray:
    """Points on the upper side of a branch."""
    along = np.linspace(start, end, points)
    return along + np.array([0.0, 0.0, radius_m * 0.99])


def test_places_are_the_branches_that_are_used(task: HangMug) -> None:
    for variant, names in NAMES.items():
        tree = task.config.variants[variant].tree
        assert [place.id for place in tree_places(tree)] == names
        assert len(tree_branches(tree_object(tree))) == 4
    assert not task.config.variants["real"].tree.branches["rear"].used


def test_a_scene_tells_all_about_its_tree(tree: TreeConfig) -> None:
    branches = tree_branches(tree_object(tree))
    for name, config in tree.branches.items():
        branch = branches[name]
        np.testing.assert_allclose(np.linalg.norm(branch.direction), 1)
        assert branch.start_world[2] == config.height_m
        assert np.arctan2(branch.direction[1], branch.direction[0]) == pytest.approx(
            config.azimuth_rad
        )
        assert branch.at(branch.length_m)[2] > config.height_m


def test_the_region_of_a_place_holds_its_branch_and_nothing_else_of_the_tree(
    tree: TreeConfig,
) -> None:
    branches = tree_branches(tree_object(tree))
    for place in tree_places(tree):
        low, high = (
            np.array(place.center_m) + sign * np.array(place.size_m) / 2 for sign in (-1, 1)
        )
        own = branches[place.id]
        outer = surface(20, own.at(0.3 * own.length_m), own.at(own.length_m), tree.branch_radius_m)
        assert np.all((outer >= low - 1e-6) & (outer <= high + 1e-6))
        for name, other in branches.items():
            if name != place.id:
                points = np.linspace(other.at(0.0), other.at(other.length_m), 50)
                assert not np.any(np.all((points > low) & (points < high), axis=1))
        angle = np.linspace(0, 2 * np.pi, 60)
        rim = tree.trunk_radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        trunk = rim + np.array(tree.position_m[:2])
        assert not np.any(np.all((trunk > low[:2]) & (trunk < high[:2]), axis=1))


def test_geometry_is_foot_trunk_and_branches(tree: TreeConfig) -> None:
    body = tree_geometry(tree_object(tree))
    assert len(body.collision) == 2 + len(tree.branches)
    assert all(part.is_convex and part.is_watertight for part in body.collision)
    assert body.visual.bounds[0, 2] == pytest.approx(0)


def test_branches_are_called_what_they_are(task: HangMug) -> None:
    phrases = task.components()
    for variant, names in NAMES.items():
        scene = task.sample_layout(np.random.default_rng(0), variant=variant)
        for name in names:
            assert phrases[f"{spoken(name)} branch"].extract(scene) == (name,)


def test_words_that_fit_several_branches_or_none_name_nothing(task: HangMug) -> None:
    phrases = task.components()
    scene = task.sample_layout(np.random.default_rng(0))
    for words in ("right branch", "left branch", "top branch"):
        assert phrases[words].extract(scene) == ()
    assert phrases["right branch"].extract(Layout(scene.objects, ())) == ()


def test_a_branch_that_is_taken_is_not_named(task: HangMug) -> None:
    scene = task.sample_layout(np.random.default_rng(0))
    mug = scene.objects[0].model_copy(update={"place": "right_middle"})
    taken = Layout((mug, *scene.objects[1:]), scene.places)
    assert task.components()["right-middle branch"].extract(taken) == ()
    # What is top and middle does not change with it.
    assert task.components()["left-middle branch"].extract(taken) == ("left_middle",)


def test_the_picture_names_every_branch(task: HangMug) -> None:
    shapes = tree_from_above(task.config.variants["real"].tree, "top")
    words = [shape.text for shape in shapes if hasattr(shape, "text")]
    assert words == ["right", "left", "top", "rear (not used)"]


def test_a_place_beyond_the_tip_is_refused(tree: TreeConfig) -> None:
    raw = tree.model_dump()
    with pytest.raises(ConfigError, match=r"hang_m: expected more than trunk_radius_m .* got 0\.2"):
        parse_model(TreeConfig, {**raw, "hang_m": 0.2}, "tree.yaml")


def test_the_tree_may_stand_elsewhere(tree: TreeConfig) -> None:
    moved: Vector3 = (0.1, 0.2, 0.0)
    elsewhere = tree.model_copy(update={"position_m": moved})
    shift = np.subtract(moved, tree.position_m)
    for here, there in zip(tree_places(tree), tree_places(elsewhere), strict=True):
        np.testing.assert_allclose(np.subtract(there.center_m, here.center_m), shift, atol=2e-6)
