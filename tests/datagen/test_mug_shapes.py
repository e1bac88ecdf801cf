"""Mugs of drawn shapes: bodies, handles with an opening, and what passes through it."""

from itertools import pairwise

import numpy as np
import pytest

from codediffuser.datagen.mug_meshes import mug_geometry, mug_visual
from codediffuser.datagen.mug_shapes import MugConfig, MugShape, draw_mug_shape, passes_handle
from codediffuser.datagen.tasks.hang_mug import HangMug
from codediffuser.poses import make_transform, rotation_z

FINGERS_APART_M = 0.08
UPRIGHT = make_transform(np.eye(3), np.array([0.2, -0.1, 0.3]))
LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def config() -> MugConfig:
    return HangMug.load_config().mug


@pytest.fixture(scope="module")
def drawn(config: MugConfig) -> list[MugShape]:
    rng = np.random.default_rng(0)
    return [draw_mug_shape(rng, config) for _ in range(60)]


def line_through(shape: MugShape, x: float, z: float, half_m: float = 0.05) -> list[np.ndarray]:
    """Ends in the world of a line along the mug's y through a point of its handle's plane."""
    ends = np.array([[x, -half_m, z, 1.0], [x, half_m, z, 1.0]])
    return [(UPRIGHT @ end)[:3] for end in ends]


def test_sizes_survive_the_scene_file(drawn: list[MugShape]) -> None:
    for shape in drawn:
        assert MugShape.of(shape.sizes()) == shape


def test_every_style_is_drawn(config: MugConfig, drawn: list[MugShape]) -> None:
    for style in config.styles.values():
        (low, high), (narrow, wide) = style.height_m, style.handle_squareness
        assert any(
            low <= s.height_m <= high and narrow <= s.handle_squareness <= wide for s in drawn
        )


def test_bodies_fit_between_the_fingers_and_branches_through_the_handles(
    drawn: list[MugShape],
) -> None:
    branch = HangMug.load_config().variants["sim"].tree.branch_radius_m
    for shape in drawn:
        assert 2 * shape.rim_radius_m < FINGERS_APART_M - 0.008
        for low, high in (shape.opening_x_m, shape.opening_z_m):
            assert high - low > 2 * branch + 0.010


def test_the_opening_is_open(config: MugConfig, drawn: list[MugShape]) -> None:
    # A handle whose collision parts were one hull would be filled, and nothing could hang by it.
    for shape in drawn[:10]:
        parts = mug_geometry(shape, config).collision
        (x_low, x_high), (z_low, z_high) = shape.opening_x_m, shape.opening_z_m
        inside = np.array(
            [[(x_low + x_high) / 2, y, z] for y in (-0.004, 0, 0.004) for z in (-0.01, 0, 0.01)]
        )
        assert z_low < -0.01 and z_high > 0.01
        for part in parts:
            assert part.is_convex and part.is_watertight
            offsets = np.einsum("ij,ij->i", part.face_normals, part.triangles[:, 0])
            assert np.all((inside @ part.face_normals.T - offsets).max(axis=1) > 0)


def test_the_handle_is_one_chain_from_wall_to_wall(
    config: MugConfig, drawn: list[MugShape]
) -> None:
    for shape in drawn[:10]:
        body, *blocks = mug_geometry(shape, config).collision
        for one, other in pairwise(blocks):
            shared = {tuple(v) for v in np.round(one.vertices, 6)}
            assert len(shared & {tuple(v) for v in np.round(other.vertices, 6)}) == 4
        for end in (blocks[0], blocks[-1]):
            assert end.vertices[:, 0].min() < body.vertices[:, 0].max()


def test_what_is_seen_is_what_collides_but_for_the_hollow(
    config: MugConfig, drawn: list[MugShape]
) -> None:
    for shape in drawn[:10]:
        parts = mug_geometry(shape, config).collision
        low = np.min([p.bounds[0] for p in parts], axis=0)
        high = np.max([p.bounds[1] for p in parts], axis=0)
        seen = mug_visual(shape)
        np.testing.assert_allclose(seen.bounds, [low, high], atol=0.0015)
        assert seen.volume < sum(part.volume for part in parts) / 2


@pytest.mark.parametrize(
    ("where", "through"),
    [("middle", True), ("high", True), ("body", False), ("outside", False), ("above", False)],
)
def test_a_line_passes_the_handle_or_not(drawn: list[MugShape], where: str, through: bool) -> None:
    for shape in drawn[:10]:
        x_low, x_high = shape.opening_x_m
        middle = (x_low + x_high) / 2
        x, z = {
            "middle": (middle, 0.0),
            "high": (middle, shape.opening_z_m[1] - 0.004),
            "body": (x_low - 0.01, 0.0),
            "outside": (x_high + shape.handle_thickness_m + 0.002, 0.0),
            "above": (middle, shape.opening_z_m[1] + shape.handle_thickness_m + 0.002),
        }[where]
        assert passes_handle(shape, UPRIGHT, *line_through(shape, x, z)) == through


def test_a_line_that_ends_in_the_opening_does_not_pass(drawn: list[MugShape]) -> None:
    shape = drawn[0]
    start, end = line_through(shape, sum(shape.opening_x_m) / 2, 0.0)
    assert passes_handle(shape, UPRIGHT, start, end)
    assert passes_handle(shape, UPRIGHT, end, start)
    assert not passes_handle(shape, UPRIGHT, start, start + 0.4 * (end - start))
    turned = UPRIGHT @ make_transform(rotation_z(np.pi / 2), np.zeros(3))
    assert not passes_handle(shape, turned, start, end)


def test_the_lowest_point_of_a_body(drawn: list[MugShape]) -> None:
    shape = drawn[0]
    assert shape.lowest_z_m(UPRIGHT) == pytest.approx(0.3 - shape.height_m / 2)
    lying = make_transform(LYING, np.array([0.0, 0.0, 0.3]))
    assert shape.lowest_z_m(lying) == pytest.approx(0.3 - shape.rim_radius_m)
