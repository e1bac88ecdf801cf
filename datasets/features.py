"""Every key of an exported dataset: name, shape, dtype, unit and what it means.

Only true policy inputs live under `observation.`; LeRobot infers roles from names.
"""

from __future__ import annotations

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
