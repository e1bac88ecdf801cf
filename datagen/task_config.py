"""What the YAML of every task holds: cameras, robot, workspace, whose left and right, splits."""

from __future__ import annotations

from typing import ClassVar, Generic, Self

import numpy as np
from pydantic import Field, model_validator

from codediffuser.datagen.configuration_split import SplitConfig
from codediffuser.datagen.layout import V
from codediffuser.datagen.scene import Vector3
from codediffuser.datagen.task_words import WordsConfig
from codediffuser.schema import Document, Strict


class CameraView(Strict):
    """Where one camera stands and looks."""

    name: str
    position_m: Vector3
    look: Vector3
    """Direction of the optical axis, any length."""
    right: Vector3
    """Roughly the image's right; made orthogonal to `look`."""


class CameraConfig(Strict):
    """The cameras of a task. Pixels are square."""

    width: int = 320
    height: int = 240
    fov_y_rad: float = 0.9
    near_m: float = 0.05
    far_m: float = 5.0
    views: tuple[CameraView, ...]


class RobotConfig(Strict):
    """Where the arm stands and how it starts."""

    base_position_m: Vector3
    base_yaw_rad: float
    initial_qpos: tuple[float, ...]
    """Seven arm joints in rad, two fingers in m."""


class Workspace(Strict):
    """Box of the world that policies and labels look at."""

    low_m: Vector3
    high_m: Vector3


class Observer(Strict):
    """Whose left and right the words mean. The default stands at the robot and looks along +y."""

    right: tuple[float, float] = (1.0, 0.0)
    """Direction of "right" on the table, world x and y, unit length."""
    front: tuple[float, float] = (0.0, -1.0)
    """Direction of "front": toward the observer. The public release has (0, 1) here."""

    @model_validator(mode="after")
    def _unit_and_square(self) -> Self:
        right, front = np.array(self.right), np.array(self.front)
        lengths = [float(np.linalg.norm(v)) for v in (right, front)]
        if abs(right @ front) > 1e-6 or max(abs(length - 1) for length in lengths) > 1e-6:
            raise ValueError("`right` and `front` must have length 1 and a right angle between")
        return self

    @property
    def left(self) -> tuple[float, float]:
        """Opposite of `right`."""
        return (-self.right[0], -self.right[1])

    @property
    def back(self) -> tuple[float, float]:
        """Opposite of `front`."""
        return (-self.front[0], -self.front[1])

    @property
    def extremes(self) -> tuple[tuple[str, tuple[float, float]], ...]:
        """What the object farthest along each direction is called, with that direction."""
        return (
            ("left-most", self.left),
            ("right-most", self.right),
            ("front-most", self.front),
            ("back-most", self.back),
        )


class ClusterConfig(Strict):
    """How large the instances of one category are, for clouds thinned to 8000 points."""

    eps_m: float = Field(gt=0)
    """Points this near are neighbours: above the spacing of the points, below the gap between
    two instances."""
    min_neighbours: int = Field(default=5, ge=1)
    """A core point has at least that many neighbours, itself included."""
    min_points: int = Field(default=20, ge=1)
    """Smaller clusters are dropped."""
    min_share: float = Field(default=0.2, ge=0, le=1)
    """So are those with fewer points than this share of the median cluster's."""
    vote_reach_m: float | None = Field(default=None, gt=0)
    """Where features tell the middle of the instance that a point belongs to: votes this near to
    one middle are votes for it. Below half the distance between the middles of two instances."""
    vote_weights: Vector3 = (1.0, 1.0, 1.0)
    """How much a distance between votes counts along each axis of the world: little along an axis
    on which instances do not differ, as books of one row in depth and height."""


class RowSearchConfig(Strict):
    """How the boxes of a row are told apart by their shape, see `labeling/perception/rows.py`."""

    front_m: float = Field(default=0.012, gt=0)
    """Depth behind the front of a box within which readings show its front face."""
    tolerance_m: float = Field(default=0.004, ge=0)
    """How much thicker than the thickest box, and thinner than the thinnest, one may look."""
    max_lean_rad: float = Field(default=0.5, gt=0)
    margin_m: float = Field(default=0.003, ge=0)
    """Readings this far outside of a box may still be its own: depth comes in whole millimetres."""
    min_gap_m: float = Field(default=0.012, gt=0)
    """Neighbours with less room between them leave no gap, wherever one measures."""


class LabelingConfig(Strict):
    """How the task is labelled."""

    view: str = "top"
    """What the window opens with: `top` for the plan, or the name of the camera to choose targets
    in."""
    clusters: dict[str, ClusterConfig] = Field(default_factory=dict)
    """Sizes by category, to find instances by their features."""
    row: RowSearchConfig = RowSearchConfig()
    """Of a task whose objects stand in a row."""


class ResetImageConfig(Strict):
    """How the operator's picture is drawn."""

    pad_margin_m: float
    """How far the pad reaches beyond the area that objects are put in."""
    cross_spacing_m: float


class TaskConfig(Document, Generic[V]):
    """What every task's YAML holds (`schema: codediffuser.task/1`)."""

    KIND: ClassVar[str] = "task"
    VERSION: ClassVar[int] = 1

    task: str
    max_steps: int
    """Control steps after which a rollout ends."""
    cameras: CameraConfig
    robot: RobotConfig
    workspace: Workspace
    observer: Observer = Observer()
    splits: SplitConfig = SplitConfig()
    labeling: LabelingConfig = LabelingConfig()
    words: WordsConfig = WordsConfig()
    reset_image: ResetImageConfig
    variants: dict[str, V]
    """Ranges that scenes are drawn from, by name."""
