"""The policy's cloud: fixed blocks, the right points in each, the same every time."""

from __future__ import annotations

import numpy as np
import pytest

from codediffuser.datasets.clouds import CloudConfig, View, check_cloud, cloud_rng, policy_cloud
from codediffuser.errors import RenderError, ShapeError
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.label import AttentionLabel, Provenance
from codediffuser.poses import make_transform

BY = Provenance(source="simulator", labeler="test", tool_version="0")
LOW, HIGH = np.array([-0.3, -0.3, 0.0]), np.array([0.3, 0.3, 0.5])
HAND = make_transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.2034]))
"""Pointing down, its tool centre at (0, 0, 0.1)."""


class Bench:
    """A camera 1 m above a table of 0.1 m height that shows a plane with bumps of given points."""

    def __init__(self) -> None:
        self.K = np.array([[100.0, 0, 63.5], [0, 100.0, 47.5], [0, 0, 1]])
        self.T_world_camera = make_transform(np.diag([1.0, -1, -1]), np.array([0, 0, 1.0]))

    def view(self, depth_m: float = 0.9) -> View:
        return View(np.full((96, 128), depth_m, np.float32), self.K, self.T_world_camera)


def square(x: float, y: float, half: float = 0.03) -> np.ndarray:
    xy = np.stack(np.meshgrid(np.linspace(-half, half, 9), np.linspace(-half, half, 9)), -1)
    flat = xy.reshape(-1, 2) + np.array([x, y])
    return np.column_stack([flat, np.full(len(flat), 0.1)]).astype(np.float32)


@pytest.fixture
def field() -> AttentionField:
    labels = [
        AttentionLabel("pick", "b", "b", square(0.2, 0.2), "b", BY),
        AttentionLabel("place", "s", "s", square(-0.2, -0.2), None, BY),
    ]
    # Above half the diagonal of the camera's pixels, which lie 9 mm apart on the table.
    return AttentionField(labels, {"b": np.eye(4)}, radius_m=0.007)


def cloud_of(
    field: AttentionField, config: CloudConfig | None = None, frame: int = 0, **options: object
) -> np.ndarray:
    views = options.pop("views", [Bench().view()])
    now = options.pop("now", {"b": np.eye(4)})
    return policy_cloud(
        views, field, now, HAND, LOW, HIGH, cloud_rng(0, 0, frame), config, **options
    )  # type: ignore[arg-type]


def test_default_cloud_is_512_points_in_four_blocks(field: AttentionField) -> None:
    cloud = cloud_of(field)
    assert cloud.shape == (512, 5) and cloud.dtype == np.float32
    pick, place, hand, rest = np.split(cloud, [128, 256, 384])
    seen = 49  # pixels of a 6 cm square at 0.9 m
    assert pick[:, 3].sum() >= seen and not pick[:, 4].any()
    assert place[:, 4].sum() >= seen and not place[:, 3].any()
    assert not hand[:, 3:].any() and not rest[:, 3:].any()
    check_cloud(cloud, CloudConfig())


def test_points_lie_where_their_block_says(field: AttentionField) -> None:
    config = CloudConfig(pick_points=40, place_points=40, hand_points=64, rest_points=64)
    pick, place, hand, rest = np.split(cloud_of(field, config), [40, 80, 144])
    assert np.abs(pick[:, :2] - 0.2).max() < 0.037
    assert np.abs(place[:, :2] + 0.2).max() < 0.037
    tool = np.array([0, 0, 0.1])
    assert np.linalg.norm(hand[:, :3] - tool, axis=1).max() <= 0.12
    assert np.linalg.norm(rest[:, :3] - tool, axis=1).min() > 0.12
    assert ((rest[:, :3] >= LOW) & (rest[:, :3] <= HIGH)).all()


def test_same_address_same_cloud_and_other_frame_another(field: AttentionField) -> None:
    config = CloudConfig(max_candidates=200)
    assert np.array_equal(cloud_of(field, config), cloud_of(field, config))
    assert not np.array_equal(cloud_of(field, config), cloud_of(field, config, frame=1))


def test_pick_block_follows_the_object(field: AttentionField) -> None:
    now = {"b": make_transform(np.eye(3), np.array([-0.2, 0.0, 0.0]))}
    cloud = cloud_of(field, now=now)
    attended = cloud[cloud[:, 3] > 0]
    assert np.allclose(attended[:, :2].mean(axis=0), [0.0, 0.2], atol=0.004)


def test_a_short_block_is_filled_with_unattended_points_of_the_rest(field: AttentionField) -> None:
    cloud = cloud_of(field, CloudConfig(pick_points=400))
    pick = cloud[:400]
    assert 49 <= pick[:, 3].sum() < 400
    filled = pick[pick[:, 3] == 0]
    assert len(np.unique(filled[:, :3], axis=0)) == len(filled), "spare points do not repeat"
    assert len(np.unique(cloud[:, :3], axis=0)) == len(cloud)


def test_hidden_targets_are_remembered_where_they_are(field: AttentionField) -> None:
    """Both targets below a cover: only remembered points can be attended."""
    cover = [Bench().view(depth_m=0.7)]
    cloud = cloud_of(field, views=cover)
    for channel, x in ((3, 0.2), (4, -0.2)):
        attended = cloud[cloud[:, channel] > 0]
        assert len(attended) == 81
        assert np.allclose(attended[:, :3].mean(axis=0), [x, x, 0.1], atol=1e-6)
    forgetful = cloud_of(field, CloudConfig(remembered=False), views=cover)
    assert not forgetful[:, 3:].any()


def test_seen_targets_need_no_memory(field: AttentionField) -> None:
    config = CloudConfig(pick_points=300, place_points=0, hand_points=0, rest_points=0)
    seen = cloud_of(field, config)
    assert np.array_equal(seen, cloud_of(field, config.model_copy(update={"remembered": False})))


def test_few_readings_are_repeated_to_the_fixed_size(field: AttentionField) -> None:
    depth = np.zeros((96, 128), np.float32)
    depth[48, 64] = 0.9
    view = View(depth, Bench().K, Bench().T_world_camera)
    cloud = cloud_of(field, CloudConfig(remembered=False), views=[view])
    assert cloud.shape == (512, 5)
    assert len(np.unique(cloud, axis=0)) == 1


@pytest.mark.parametrize("views", [[], [Bench().view(depth_m=0.0)], [Bench().view(depth_m=1.9)]])
def test_seeing_nothing_is_an_error_with_a_remedy(field: AttentionField, views: list[View]) -> None:
    with pytest.raises(RenderError, match=r"none of them in the workspace.*check the cameras"):
        cloud_of(field, views=views)


def test_swapped_attention_is_cleaned_before_points_are_chosen(field: AttentionField) -> None:
    def strays(config: CloudConfig) -> int:
        cloud = cloud_of(field, config, corrupt_share=0.15)
        attended = cloud[cloud[:, 3] > 0]
        return int((np.abs(attended[:, :2] - 0.2).max(axis=1) > 0.05).sum())

    assert strays(CloudConfig(clean=False)) >= 5
    assert strays(CloudConfig(clean_eps_m=0.014)) == 0


def test_quotas_of_zero_leave_a_block_out(field: AttentionField) -> None:
    config = CloudConfig(hand_points=0, rest_points=0)
    assert cloud_of(field, config).shape == (256, 5)


def test_check_cloud_names_both_shapes() -> None:
    with pytest.raises(ShapeError, match=r"\(512, 5\) float32, got \(3, 5\) float64"):
        check_cloud(np.zeros((3, 5)), CloudConfig())


def test_configuration_goes_through_json() -> None:
    config = CloudConfig(pick_points=7, clean=False)
    assert CloudConfig.model_validate(config.model_dump(mode="json")) == config
