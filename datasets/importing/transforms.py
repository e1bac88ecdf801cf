"""The tree of frames of a recording: the pose of any frame in the world at a moment.

Moving transforms are looked up as every signal is: the latest not after the moment.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from codediffuser.errors import DatasetError
from codediffuser.poses import invert_transform


@dataclass(frozen=True, slots=True)
class Edge:
    """One moving transform."""

    times_ns: np.ndarray
    """(n,) int64, ascending."""
    T_parent_child: np.ndarray
    """(n, 4, 4) float64."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A frame in the world at one moment."""

    T: np.ndarray
    """(4, 4) float64."""
    time_ns: int | None
    """Of the oldest moving transform on the way; None when all of them are static."""
    moving: bool


class TransformTree:
    """Static and moving transforms by child; a child has one parent.

    Args:
        static: (parent, child, T_parent_child).
        moving: (parent, child, time, T_parent_child), in any order.
    """

    def __init__(
        self,
        static: Iterable[tuple[str, str, np.ndarray]],
        moving: Iterable[tuple[str, str, int, np.ndarray]] = (),
    ) -> None:
        self._parent: dict[str, str] = {}
        self._static: dict[str, np.ndarray] = {}
        self._edges: dict[str, Edge] = {}
        for parent, child, T in static:
            self._parent[child] = parent
            self._static[child] = T
        found: dict[str, list[tuple[int, np.ndarray]]] = {}
        for parent, child, time_ns, T in moving:
            self._parent[child] = parent
            found.setdefault(child, []).append((time_ns, T))
        for child, samples in found.items():
            samples.sort(key=lambda sample: sample[0])
            self._edges[child] = Edge(
                np.array([t for t, _ in samples], np.int64), np.stack([T for _, T in samples])
            )
            self._static.pop(child, None)

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted(set(self._parent) | set(self._parent.values()))

    def chain(self, frame: str) -> list[str]:
        """A frame and those above it, up to a root."""
        names = [frame]
        while names[-1] in self._parent and len(names) <= len(self._parent) + 1:
            names.append(self._parent[names[-1]])
        return names

    def is_moving(self, world: str, frame: str) -> bool:
        """Whether a moving transform lies between the world and a frame."""
        return any(name in self._edges for name in self._way(world, frame))

    def edges(self, world: str, frame: str) -> dict[str, Edge]:
        """Moving transforms between the world and a frame, by child."""
        return {n: self._edges[n] for n in self._way(world, frame) if n in self._edges}

    def lookup(self, world: str, frame: str, time_ns: int) -> Pose:
        """Pose of a frame in the world.

        Raises:
            DatasetError: The frames are not connected, or a moving transform comes only later.
        """
        self._way(world, frame)
        T_common_world, oldest_up, moving_up = self._climb(world, frame, time_ns)
        T_common_frame, oldest_down, moving_down = self._climb(frame, world, time_ns)
        known = [t for t in (oldest_up, oldest_down) if t is not None]
        return Pose(
            invert_transform(T_common_world) @ T_common_frame,
            min(known) if known else None,
            moving_up or moving_down,
        )

    def _way(self, world: str, frame: str) -> list[str]:
        """Children of all transforms between two frames."""
        up, down = self.chain(world), self.chain(frame)
        common = next((name for name in down if name in up), None)
        if common is None:
            raise DatasetError(
                f"transforms do not connect '{frame}' with the world frame '{world}'; frames: "
                f"{', '.join(self.frames) or 'none'}. Set world_frame, or give T_world_camera"
            )
        return down[: down.index(common)] + up[: up.index(common)]

    def _climb(self, frame: str, other: str, time_ns: int) -> tuple[np.ndarray, int | None, bool]:
        """T_common_frame, time of the oldest moving transform, and whether there was one."""
        above = set(self.chain(other))
        T, oldest, moving = np.eye(4), None, False
        for name in self.chain(frame):
            if name in above:
                break
            T_parent, time_of = self._sample(name, time_ns)
            T = T_parent @ T
            if time_of is not None:
                moving = True
                oldest = time_of if oldest is None else min(oldest, time_of)
        return T, oldest, moving

    def _sample(self, child: str, time_ns: int) -> tuple[np.ndarray, int | None]:
        if child in self._static:
            return self._static[child], None
        edge = self._edges[child]
        i = int(np.searchsorted(edge.times_ns, time_ns, side="right")) - 1
        if i < 0:
            raise DatasetError(f"the transform to '{child}' comes only after the moment asked for")
        return edge.T_parent_child[i], int(edge.times_ns[i])
