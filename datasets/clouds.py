"""Camera views and labels to the policy's point cloud: one function for export and closed loop.

A policy must meet in closed loop what it was trained on, so `convert` and `eval` both call
`policy_cloud` and nothing else. Its `CloudConfig` is stored with every dataset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from codediffuser.datagen.scene import Vector3
from codediffuser.datasets.features import POINT_CHANNELS
from codediffuser.errors import RenderError, ShapeError
from codediffuser.labeling.attention import (
    RADIUS_M,
    AttentionField,
    clean_attention,
    corrupt_attention,
)
from codediffuser.pointcloud import farthest_point_indices, fuse_views, inside_box
from codediffuser.poses import apply_transform
from codediffuser.schema import Strict
from codediffuser.seeding import Stage, rng_for


class View(NamedTuple):
    """One depth picture and where it was taken."""

    depth_m: np.ndarray
    """(H, W) float32 along the optical axis, 0 for no reading."""
    K: np.ndarray
    """(3, 3) float64 intrinsics, pixels."""
    T_world_camera: np.ndarray
    """(4, 4) float64, OpenCV axes."""


class CloudConfig(Strict):
    """How many points of what a policy cloud holds."""

    pick_points: int = Field(default=128, ge=0)
    place_points: int = Field(default=128, ge=0)
    hand_points: int = Field(default=128, ge=0)
    rest_points: int = Field(default=128, ge=0)
    """Everything else in the workspace: other objects, the crate, the arm."""
    hand_radius_m: float = 0.12
    """How far around the tool centre points count as being at the hand."""
    tool_offset_m: Vector3 = (0.0, 0.0, 0.1034)
    """Tool centre, between the finger tips, in the frame of `panda_hand`."""
    attention_radius_m: float = RADIUS_M
    """How far from a labelled point attention reaches; for whoever builds the field."""
    remembered: bool = True
    """Whether labelled points of frame 0 stand in, where their object has taken them, for parts
    that no camera sees now: the hand hides the slot from the camera above while it lowers."""
    clean: bool = True
    """Whether strays of the attention are dropped, see `labeling.attention.clean_attention`."""
    clean_eps_m: float = 0.012
    max_candidates: int = 4096
    """Larger groups are thinned at random to that many before they are sampled evenly."""

    @property
    def quotas(self) -> tuple[int, int, int, int]:
        """Rows of the blocks pick, place, hand and rest, in the order of the cloud."""
        return (self.pick_points, self.place_points, self.hand_points, self.rest_points)

    @property
    def num_points(self) -> int:
        """N, the rows of a cloud."""
        return sum(self.quotas)


def cloud_rng(root_seed: int, episode_index: int, frame: int) -> np.random.Generator:
    """Generator of one frame's cloud, the same whatever was computed before."""
    return rng_for(root_seed, Stage.CLOUD, episode_index, frame)


def policy_cloud(
    views: Sequence[View],
    field: AttentionField,
    T_world_now: Mapping[str, np.ndarray],
    T_world_hand: np.ndarray,
    low_m: np.ndarray,
    high_m: np.ndarray,
    rng: np.random.Generator,
    config: CloudConfig | None = None,
    *,
    corrupt_share: float = 0.0,
) -> np.ndarray:
    """Fuse, crop, attend, and choose a fixed number of points.

    The rows come in four blocks of fixed size, each sampled evenly from its group. A point belongs
    to the first group that fits: attended for picking, attended for placing, near the hand, the
    rest. A block whose group is too small is filled with unattended points, first of the rest, then
    at the hand; when these run out too, points are repeated.

    Args:
        views: What the cameras see now.
        field: The episode's attention.
        T_world_now: Poses (4, 4) now of the objects that `field` follows.
        T_world_hand: (4, 4) measured pose of `panda_hand`.
        low_m: (3,) lowest corner of the workspace.
        high_m: (3,) highest corner.
        rng: Generator of this frame, see `cloud_rng`.
        config: Sizes; None for the defaults. Use the one that a policy's dataset was made with.
        corrupt_share: Part of the attended points that is swapped for wrong ones before cleaning
            (stress test).

    Returns:
        cloud: (N, 5) float32: world xyz in metres, attention for picking and for placing.

    Raises:
        RenderError: No camera sees anything in the workspace.
        LabelError: A followed object has no pose.
    """
    config = config or CloudConfig()
    points, attention = _attended_scene(views, field, T_world_now, low_m, high_m, config)
    if corrupt_share > 0:
        attention = corrupt_attention(attention, rng, corrupt_share)
    if config.clean:
        attention = clean_attention(points, attention, eps_m=config.clean_eps_m)
    tool = apply_transform(T_world_hand, np.array([config.tool_offset_m], dtype=np.float32))[0]
    offset = points - tool
    at_hand = np.einsum("ij,ij->i", offset, offset) <= config.hand_radius_m**2
    rows = _choose_rows(points, _groups(attention, at_hand), rng, config)
    return np.concatenate([points[rows], attention[rows]], axis=1)


def check_cloud(cloud: np.ndarray, config: CloudConfig) -> None:
    """Raise `ShapeError` unless `cloud` is what a policy of this configuration takes."""
    expected = (config.num_points, len(POINT_CHANNELS))
    if cloud.shape != expected or cloud.dtype != np.float32:
        raise ShapeError(f"cloud: expected {expected} float32, got {cloud.shape} {cloud.dtype}")


def _attended_scene(
    views: Sequence[View],
    field: AttentionField,
    T_world_now: Mapping[str, np.ndarray],
    low_m: np.ndarray,
    high_m: np.ndarray,
    config: CloudConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Points (M, 3) of the workspace and their attention (M, 2), remembered points included."""
    seen = fuse_views(views)
    points = seen[inside_box(seen, low_m, high_m)]
    if len(points) == 0:
        raise RenderError(
            f"{len(views)} cameras give {len(seen)} readings, none of them in the workspace "
            f"{np.round(low_m, 3).tolist()} to {np.round(high_m, 3).tolist()} m; check the "
            "cameras' poses and the task's `workspace`"
        )
    attention = field.at(points, T_world_now)
    if not config.remembered:
        return points, attention
    carried, channels = field.carried(T_world_now)
    inside = inside_box(carried, low_m, high_m)
    carried, channels = carried[inside], channels[inside]
    hidden = np.zeros(len(carried), dtype=bool)
    for channel in range(channels.shape[1]):
        mine = np.flatnonzero(channels[:, channel] > 0)
        hidden[mine] = _far_from(carried[mine], points[attention[:, channel] > 0], field.radius_m)
    return (
        np.concatenate([points, carried[hidden]]),
        np.concatenate([attention, channels[hidden]]),
    )


def _far_from(points: np.ndarray, others: np.ndarray, radius_m: float) -> np.ndarray:
    """Which of the points (N, 3) have none of `others` (M, 3) within the radius, (N,) bool."""
    if len(others) == 0 or len(points) == 0:
        return np.ones(len(points), dtype=bool)
    distance, _ = cKDTree(others).query(points, distance_upper_bound=radius_m)
    return np.asarray(np.isinf(distance))


def _groups(attention: np.ndarray, at_hand: np.ndarray) -> list[np.ndarray]:
    """Indices of the points of each group: pick, place, hand, rest."""
    first_fit = np.full(len(attention), 3)
    first_fit[at_hand] = 2
    first_fit[attention[:, 1] > 0] = 1
    first_fit[attention[:, 0] > 0] = 0
    return [np.flatnonzero(first_fit == group) for group in range(4)]


def _choose_rows(
    points: np.ndarray, groups: list[np.ndarray], rng: np.random.Generator, config: CloudConfig
) -> np.ndarray:
    """Index of the point of each row of the cloud, (N,) int64."""
    groups = [_thin(group, rng, config.max_candidates) for group in groups]
    short = [max(0, quota - len(g)) for quota, g in zip(config.quotas, groups, strict=True)]
    # One run over the rest serves its own block and the gaps of the others: evenly spread rows
    # that are chosen first also come first.
    spare = _spread(points, groups[3], config.rest_points + sum(short[:3]))
    blocks = []
    for group, quota in zip(groups[:3], config.quotas[:3], strict=True):
        blocks.append(_spread(points, group, quota))
    blocks.append(spare[: config.rest_points])
    spare = spare[config.rest_points :]
    unused = np.setdiff1d(groups[2], blocks[2])
    spare = np.concatenate([spare, unused])
    every = np.concatenate(groups)
    rows = []
    for block, quota in zip(blocks, config.quotas, strict=True):
        gap = quota - len(block)
        fill, spare = spare[:gap], spare[gap:]
        again = np.resize(every, gap - len(fill))
        rows.append(np.concatenate([block, fill, again]))
    return np.concatenate(rows)


def _spread(points: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(group[farthest_point_indices(points[group], count)])


def _thin(group: np.ndarray, rng: np.random.Generator, limit: int) -> np.ndarray:
    if len(group) <= limit:
        return group
    return np.sort(rng.choice(group, size=limit, replace=False))
