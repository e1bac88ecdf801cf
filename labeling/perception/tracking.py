"""Follows a picked object through a recording by geometry, the hand, and features where in doubt.

No simulator: where the object was at frame 0 comes from its label. While it stands it stays where
it is, as long as the cameras do not see through it. Once the fingers have closed beside it, it
moves with the hand. Where neither explains what the cameras see, it is looked for straight below,
as things fall that are let go, and among the instances of its category, which it is fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.datagen.episode import Episode
from codediffuser.errors import LabelError
from codediffuser.labeling.perception.finding import FoundInstance
from codediffuser.labeling.perception.fitting import Evidence, evidence, fit_rigid
from codediffuser.labeling.perception.views import View
from codediffuser.pointcloud import farthest_point_indices
from codediffuser.poses import apply_transform, invert_transform, make_transform, rot6d_to_matrix

POINTS = 300
"""Points of the object that are followed."""
GRASP_REACH_M = 0.14
"""From the origin of the hand to the nearest point of what it can hold: fingers are 0.11 m long."""
CLOSED_M = 0.003
"""Fingers that stop this much short of shut, or more, hold something."""
OPEN_M = 0.036
"""Fingers this far open hold nothing; 0.04 m is their limit."""
MOVED_M = 0.0015
"""A finger that opens by more than this lets go."""
SURE = 0.9
"""Below this confidence the object is looked for."""
NUDGE_M = 0.002
BETTER = 0.02
"""A pose must explain this share of the points more to take the place of another."""
SEARCH_M = 0.15
"""How far from where it was expected an object is looked for."""

Look = Callable[[Sequence[View]], Sequence[FoundInstance]]
"""Finds the instances of the object's category in one frame."""


@dataclass(frozen=True, slots=True)
class Track:
    """How an object moved through a recording."""

    T_now_start: np.ndarray
    """(T, 4, 4) float64: takes its points at frame 0 to where they are at each frame."""
    confidence: np.ndarray
    """(T,) float32: share of its points in view that the cameras confirm, in [0, 1]; 0 when they
    confirm none."""
    held: np.ndarray
    """(T,) bool: whether it was taken to move with the hand."""


def track_object(episode: Episode, points_world: np.ndarray, look: Look | None = None) -> Track:
    """Follow an object through all frames of an episode.

    Args:
        episode: With calibrated depth and measured hand poses.
        points_world: (N, 3) float32, metres: the object at frame 0.
        look: Finds the object's category in a frame, where geometry is in doubt; None does without.

    Raises:
        EpisodeError: The log is damaged.
        LabelError: The recording has no hand poses, or the object no points.
    """
    if len(points_world) == 0:
        raise LabelError(f"{episode.folder}: an object without points cannot be followed")
    if episode.manifest.motion.kind == "joints":
        raise LabelError(
            f"{episode.folder}: an object cannot be followed, for the recording has joint angles "
            "and no hand poses"
        )
    state = episode.state.astype(np.float64)
    hands = make_transform(rot6d_to_matrix(state[:, 3:9]), state[:, :3])
    tracker = _Tracker(points_world, look)
    poses, sure, held = [], [], []
    cameras = episode.depth_cameras
    for frame in episode.frames(list(cameras)):
        views = [View(n, frame.rgb[n], frame.depth_m[n], c) for n, c in cameras.items()]
        tracker.step(views, hands[frame.index], float(state[frame.index, 9]))
        poses.append(tracker.T_now_start)
        sure.append(tracker.confidence)
        held.append(tracker.T_hand_start is not None)
    return Track(np.stack(poses), np.array(sure, dtype=np.float32), np.array(held))


class _Tracker:
    """State of one object from frame to frame."""

    def __init__(self, points_world: np.ndarray, look: Look | None) -> None:
        chosen = points_world[farthest_point_indices(points_world, POINTS)]
        self._points = chosen.astype(np.float64)
        self._look = look
        self.T_now_start = np.eye(4)
        self.T_hand_start: np.ndarray | None = None
        """Takes the points at frame 0 to the hand's frame, while it holds the object."""
        self._evidence = Evidence(0.0, 1.0)
        self._opening_m: float | None = None
        """Of the fingers at the frame before."""
        self._grip_m = 0.0
        """Smallest opening since the object was taken."""

    def step(self, views: Sequence[View], T_world_hand: np.ndarray, opening_m: float) -> None:
        """Go on by one frame."""
        self._grip(T_world_hand, opening_m)
        if self.T_hand_start is not None:
            self.T_now_start = T_world_hand @ self.T_hand_start
        self._evidence = evidence(self._now, views)
        if self.confidence < SURE and self.T_hand_start is None:
            self._fall(views)
        if self.confidence < SURE:
            self._search(views)
            if self.T_hand_start is not None:
                self.T_hand_start = invert_transform(T_world_hand) @ self.T_now_start

    @property
    def confidence(self) -> float:
        """Of the present pose."""
        return self._evidence.confidence

    @property
    def _now(self) -> np.ndarray:
        return apply_transform(self.T_now_start, self._points)

    def _grip(self, T_world_hand: np.ndarray, opening_m: float) -> None:
        """Take the object into the hand, or let go of it, by how the fingers move."""
        before, self._opening_m = self._opening_m, opening_m
        if self.T_hand_start is None:
            stopped = before is None or abs(opening_m - before) < MOVED_M / 3
            near = np.linalg.norm(self._now - T_world_hand[:3, 3], axis=1).min() < GRASP_REACH_M
            between = CLOSED_M < opening_m < OPEN_M
            if stopped and near and between:
                self.T_hand_start = invert_transform(T_world_hand) @ self.T_now_start
                self._grip_m = opening_m
        elif opening_m > self._grip_m + MOVED_M:
            self.T_hand_start = None
        else:
            self._grip_m = min(self._grip_m, opening_m)

    def _fall(self, views: Sequence[View]) -> None:
        """Look straight below, then a little to all sides, where that explains more."""
        begin = self.T_now_start
        for step in range(1, round(SEARCH_M / NUDGE_M)):
            self._try(_shifted(begin, 2, -step * NUDGE_M), views)
        for axis in range(3):
            for shift_m in (-2 * NUDGE_M, -NUDGE_M, NUDGE_M, 2 * NUDGE_M):
                self._try(_shifted(self.T_now_start, axis, shift_m), views)

    def _search(self, views: Sequence[View]) -> None:
        """Fit the object to the nearest instance of its category, where that explains more."""
        if self._look is None:
            return
        expected = self._now.mean(axis=0)
        found = [(np.linalg.norm(f.points_world.mean(axis=0) - expected), f)
                 for f in self._look(views)]  # fmt: skip
        near = [(d, f) for d, f in found if d < SEARCH_M]
        if not near:
            return
        _, best = min(near, key=lambda pair: pair[0])
        tree = cKDTree(best.points_world)
        moved = self.T_now_start.copy()
        moved[:3, 3] += best.points_world.mean(axis=0) - expected
        for start in (self.T_now_start, moved):
            self._try(fit_rigid(self._points, tree, start), views)

    def _try(self, T_now_start: np.ndarray, views: Sequence[View]) -> None:
        """Take a pose that the cameras confirm better than the present one."""
        found = evidence(apply_transform(T_now_start, self._points), views)
        if found.balance > self._evidence.balance + BETTER:
            self.T_now_start, self._evidence = T_now_start, found


def _shifted(T: np.ndarray, axis: int, shift_m: float) -> np.ndarray:
    """A pose moved along an axis of the world."""
    moved = T.copy()
    moved[axis, 3] += shift_m
    return moved
