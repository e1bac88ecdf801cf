"""Every key of an exported dataset: name, shape, dtype, unit and what it means.

Only true policy inputs live under `observation.`; LeRobot infers roles from names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from codediffuser.datagen.trajectory import ACTION_NAMES

POINTS = "observation.points"
"""(N * C,) float32: N points of C = 5 channels, row by row, see `POINT_CHANNELS`."""

STATE = "observation.state"
"""(10,) float32: measured hand pose and mean finger opening, laid out like the action."""

ACTION = "action"
"""(10,) float32: commanded absolute hand pose in the world and finger opening."""

LABELS = "annotation.labels"
"""string: the episode's attention labels as JSON, the same in every frame."""

EPISODE_ID = "annotation.episode_id"
"""string: id of the source episode; ids, never positions, name episodes."""

POINT_CHANNELS = ("x", "y", "z", "attention_pick", "attention_place")
"""World metres, then attention in [0, 1] for each role."""

STATE_NAMES = ACTION_NAMES


@dataclass(frozen=True, slots=True)
class Feature:
    """One column as `info.json` declares it: a vector or a scalar, as edit tools need it."""

    dtype: Literal["float32", "int64", "string"]
    size: int
    """Length of the vector, 1 for a scalar."""
    names: Any = None

    def declaration(self) -> dict[str, Any]:
        """The feature's entry in `info.json`."""
        return {"dtype": self.dtype, "shape": [self.size], "names": self.names}


def policy_features(num_points: int, cloud: Mapping[str, Any]) -> dict[str, Feature]:
    """Features of the `pointcloud` profile in the order of columns, without LeRobot's own.

    Args:
        num_points: N, the points of each cloud.
        cloud: How clouds were made, JSON-like. As names of a feature it survives LeRobot's edit
            tools, which also refuse to merge datasets whose features differ.
    """
    numbers = len(POINT_CHANNELS) * num_points
    return {
        POINTS: Feature(
            "float32", numbers, {"channels": list(POINT_CHANNELS), "cloud": dict(cloud)}
        ),
        STATE: Feature("float32", len(STATE_NAMES), list(STATE_NAMES)),
        ACTION: Feature("float32", len(ACTION_NAMES), list(ACTION_NAMES)),
        LABELS: Feature("string", 1),
        EPISODE_ID: Feature("string", 1),
    }


DEFAULT_FEATURES = {
    "timestamp": Feature("float32", 1),
    "frame_index": Feature("int64", 1),
    "episode_index": Feature("int64", 1),
    "index": Feature("int64", 1),
    "task_index": Feature("int64", 1),
}
"""Columns that every LeRobot dataset has."""
