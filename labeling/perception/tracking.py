"""Follows a picked object through a recording by geometry, the hand, and features where in doubt.

No simulator: where the object was at frame 0 comes from its label. While it stands it stays where
it is, and while the fingers hold it, it moves with the hand. Where the pictures explain that less
well than before, as when fingers shift it, it is pushed or it swings, a better pose is looked for
nearby. Where that is not enough it is looked for below, tilted, and among the instances of its
category; when nothing explains the pictures better it is left where it was last.
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
from codediffuser.labeling.perception.pose_search import (
    Model,
    best_nearby,
    explained,
    model_of,
    tilted,
)
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
BETTER = 0.02
"""A pose must explain this share of the points more to take the place of another."""
LEAST_EXPLAINED = 0.1
"""An object is not taken to be where the pictures explain less of it: it may be anywhere hidden."""
WORSE = 0.03
"""A pose that explains this share of the points less than it did is improved."""
LOOK_EVERY = 4
"""Frames between two searches farther away, which are slow."""
CANDIDATES = 3
"""Instances of its category, the nearest ones, that an object is looked for in."""
TRIES = 5
"""Poses that are improved, of all that are looked at."""
FALL_M, FALLS = 0.012, 10
"""Steps in which it is looked for straight below."""
TILTS_RAD = (0.3, 0.6)
"""How far it may have tilted."""
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
    tracker = Tracker(points_world, look)
    poses, sure, held = [], [], []
    cameras = episode.depth_cameras
    for frame in episode.frames(list(cameras)):
        views = [View(n, frame.rgb[n], frame.depth_m[n], c) for n, c in cameras.items()]
        tracker.step(views, hands[frame.index], float(state[frame.index, 9]))
        poses.append(tracker.T_now_start)
        sure.append(tracker.confidence)
        held.append(tracker.T_hand_start is not None)
    return Track(np.stack(poses), np.array(sure, dtype=np.float32), np.array(held))


class Tracker:
    """State of one object from frame to frame."""

    def __init__(self, points_world: np.ndarray, look: Look | None) -> None:
        chosen = points_world[farthest_point_indices(points_world, POINTS)]
        self._points = chosen.astype(np.float64)
        self._look = look
        self._model: Model | None = None
        """With the colours of the first frame."""
        self.T_now_start = np.eye(4)
        self.T_hand_start: np.ndarray | None = None
        """Takes the points at frame 0 to the hand's frame, while it holds the object."""
        self._evidence = Evidence(0.0, 1.0)
        self._explained = 0.0
        """How well the present pose was explained when it was found."""
        self._opening_m: float | None = None
        """Of the fingers at the frame before."""
        self._grip_m = 0.0
        """Smallest opening since the object was taken."""
        self._since_look = LOOK_EVERY

    def step(self, views: Sequence[View], T_world_hand: np.ndarray, opening_m: float) -> None:
        """Go on by one frame."""
        if self._model is None:
            self._model = model_of(self._points, views)
        self._since_look += 1
        self._grip(T_world_hand, opening_m)
        if self.T_hand_start is not None:
            self.T_now_start = T_world_hand @ self.T_hand_start
        self._improve(self._model, views)
        if self.confidence < SURE and self._since_look >= LOOK_EVERY:
            self._since_look = 0
            self._search(self._model, views)
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

    def _improve(self, model: Model, views: Sequence[View]) -> None:
        """Look nearby when the pose explains the pictures less well than it did.

        A hand that holds the object tells its pose well, so it must be seen to slip.
        """
        self._evidence = evidence(self._now, views)
        here = float(explained(model, self.T_now_start[None], views)[0])
        held, last = self.T_hand_start is not None, self._explained
        self._explained = here
        if self.confidence >= SURE and (held or here > last - WORSE):
            self._explained = here if held else max(here, last)
            return
        T, best = best_nearby(model, self.T_now_start, views)
        if best > max(here + BETTER, LEAST_EXPLAINED):
            self.T_now_start, self._explained = T, best
            self._evidence = evidence(self._now, views)

    def _search(self, model: Model, views: Sequence[View]) -> None:
        """Look farther away for a pose that explains more."""
        starts = [*self._fallen(), *self._among_instances(views)]
        values = explained(model, np.stack(starts), views)
        for row in np.argsort(-values)[:TRIES]:
            T, best = best_nearby(model, starts[row], views)
            if best > max(self._explained + BETTER, LEAST_EXPLAINED):
                self.T_now_start, self._explained = T, best
        self._evidence = evidence(self._now, views)

    def _fallen(self) -> list[np.ndarray]:
        """Poses of an object that fell straight down, and tilted."""
        T, middle = self.T_now_start, self._now.mean(axis=0)
        tilts = [T, *(pose for angle in TILTS_RAD for pose in tilted(T, middle, angle))]
        return [_moved(pose, np.array([0, 0, -k * FALL_M])) for pose in tilts for k in range(FALLS)]

    def _among_instances(self, views: Sequence[View]) -> list[np.ndarray]:
        """Poses that fit the nearest instances of its category."""
        if self._look is None:
            return []
        expected = self._now.mean(axis=0)
        shifts = [(f.points_world.mean(axis=0) - expected, f) for f in self._look(views)]
        shifts.sort(key=lambda pair: float(np.linalg.norm(pair[0])))
        poses = []
        for shift, instance in shifts[:CANDIDATES]:
            if np.linalg.norm(shift) < SEARCH_M:
                tree, moved = cKDTree(instance.points_world), _moved(self.T_now_start, shift)
                fitted = (fit_rigid(self._points, tree, T) for T in (self.T_now_start, moved))
                poses += [moved, *fitted]
        return poses


def _moved(T: np.ndarray, by_m: np.ndarray) -> np.ndarray:
    """A pose moved by a vector (3,) of the world."""
    moved = T.copy()
    moved[:3, 3] += by_m
    return moved
