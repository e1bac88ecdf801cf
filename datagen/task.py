"""What a task is: how scenes are drawn, what they look like, how to solve and to judge one.

A task is one Python file and one YAML file of the same name in `datagen/tasks/`. It never imports
the simulator: it describes bodies (`Geometry`), motions (`Move`) and conditions (`Check`), and
`sim.py` and `script.py` carry them out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np
from pydantic import model_validator

from codediffuser.datagen.configuration_split import SplitConfig
from codediffuser.datagen.scene import (
    ObjectSpec,
    Pair,
    PlaceSpec,
    SceneSpec,
    Vector3,
    pickable_objects,
    untaken_places,
)
from codediffuser.registry import Registry
from codediffuser.schema import Document, Strict

if TYPE_CHECKING:
    import trimesh

    from codediffuser.datagen.drawing import Drawing
    from codediffuser.datagen.instructions.components import Component
    from codediffuser.datagen.trajectory import Trajectory


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


class LabelingConfig(Strict):
    """How the labeling window shows the task."""

    view: str = "top"
    """What it opens with: `top` for the plan, or the name of the camera to choose targets in."""


class TaskConfig(Document):
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


@dataclass(frozen=True, slots=True)
class Pad:
    """A sheet on the table that objects are put on; `pads.pdf` holds it at its true size."""

    name: str
    """Unique within the task: `pad`."""
    low_m: tuple[float, float]
    high_m: tuple[float, float]
    """Corners, world x and y."""
    cross_spacing_m: float

    def crosses_m(self) -> list[tuple[float, float]]:
        """World x and y of the cross markers, row by row from the front left.

        They lie at whole multiples of the spacing in the world, wherever the pad's edges are.
        """
        xs, ys = (
            self.cross_spacing_m
            * np.arange(
                np.ceil(low / self.cross_spacing_m - 1e-9),
                np.floor(high / self.cross_spacing_m + 1e-9) + 1,
            )
            for low, high in zip(self.low_m, self.high_m, strict=True)
        )
        return [(float(x), float(y)) for y in ys for x in xs]


@dataclass(frozen=True, slots=True)
class Layout:
    """Objects and places before targets and words are chosen."""

    objects: tuple[ObjectSpec, ...]
    places: tuple[PlaceSpec, ...]

    @property
    def pickable(self) -> tuple[ObjectSpec, ...]:
        """Objects that move and take no place yet."""
        return pickable_objects(self.objects)

    @property
    def free_places(self) -> tuple[PlaceSpec, ...]:
        """Places that no object takes."""
        return untaken_places(self.objects, self.places)


@dataclass(frozen=True, slots=True)
class Decal:
    """A picture on a body, which is only seen: the title on the spine of a book."""

    mesh: trimesh.Trimesh
    """Where it lies, in the body's frame, a little outside of the surface; metres."""
    uv: np.ndarray
    """(V, 2) float32, a point of the picture for each vertex: (0, 0) its upper left corner, (1, 1)
    its lower right one."""
    image_rgb: np.ndarray
    """(H, W, 3) uint8, sRGB."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """A body in its own frame: what is seen, and the convex parts that collide."""

    visual: trimesh.Trimesh
    """Vertices in metres; colour comes from the object's `color_rgb`."""
    collision: tuple[trimesh.Trimesh, ...]
    """Convex parts, exact; empty for a body that only looks."""
    density_kgm3: float = 1000.0
    static_friction: float = 0.3
    dynamic_friction: float = 0.3
    restitution: float = 0.1
    decals: tuple[Decal, ...] = ()
    angular_damping_per_s: float = 0.05
    """Share of a body's spin that is lost per second, beyond friction; the default is PhysX's."""


@dataclass(frozen=True, slots=True)
class Move:
    """Bring the hand to a pose, smoothly, in a given number of control steps.

    With the pose that was commanded last, it holds still and only works the gripper.
    """

    phase: str
    """Name of what the step is for, reported when it fails: `descend`, `grasp`, ..."""
    T_world_hand: np.ndarray
    """(4, 4) float64 pose of `panda_hand`."""
    steps: int
    gripper_m: float
    """Opening of each finger that is reached at the end of the move, 0 to 0.04 m."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One measured condition: `value` is compared with `threshold` by `relation`."""

    name: str
    value: float
    threshold: float
    holds: bool


@dataclass(frozen=True, slots=True)
class Check:
    """Every condition of success for the best (object, place) pair, and that pair."""

    pair: Pair | None
    conditions: tuple[Condition, ...]

    @property
    def success(self) -> bool:
        """Whether all conditions hold."""
        return self.pair is not None and all(c.holds for c in self.conditions)

    @property
    def reason(self) -> str:
        """Names of the conditions that fail, or an empty string."""
        return ", ".join(c.name for c in self.conditions if not c.holds)


class SceneView(Protocol):
    """What scripts and checks may look at: the simulator, a trajectory, or a tracker."""

    @property
    def scene(self) -> SceneSpec:
        """The configuration that was reset to."""

    def T_world_object(self, object_id: str) -> np.ndarray:
        """Pose (4, 4) float64 of a movable object now."""

    def object_speed(self, object_id: str) -> tuple[float, float]:
        """Linear m/s and angular rad/s of a movable object now."""

    def T_world_hand(self) -> np.ndarray:
        """Pose (4, 4) float64 of `panda_hand` now."""

    def gripper_opening_m(self) -> float:
        """Mean opening of the two fingers now, 0 to 0.04 m each."""


C = TypeVar("C", bound=TaskConfig)


class Task(ABC, Generic[C]):
    """Base of all tasks.

    Args:
        config: The parsed YAML; None reads the file that ships beside the task's module.
    """

    name: ClassVar[str]
    config_type: ClassVar[type[TaskConfig]]
    pick_category: ClassVar[str]
    """Category of the objects that are picked; also the placeholder in templates."""
    place_category: ClassVar[str]
    """Category of the places; also the placeholder in templates."""
    push_phases: ClassVar[tuple[str, ...]] = ("approach", "transport")
    """Phases of the script in which the hand has air all around, so that recovery demonstrations
    may push it."""

    def __init__(self, config: C | None = None) -> None:
        self.config: C = config if config is not None else self.load_config()

    @classmethod
    def config_path(cls) -> Path:
        """The YAML that ships with the task."""
        return Path(__file__).parent / "tasks" / f"{cls.name}.yaml"

    @classmethod
    def load_config(cls, path: Path | None = None) -> C:
        """Read the task's YAML, or another file of the same schema."""
        return cls.config_type.load(path or cls.config_path())  # type: ignore[return-value]

    @abstractmethod
    def sample_layout(
        self,
        rng: np.random.Generator,
        *,
        variant: str = "sim",
        picks: int | None = None,
        places: int | None = None,
    ) -> Layout:
        """Draw objects and places.

        Args:
            rng: The only source of chance.
            variant: Which ranges of the YAML to draw from.
            picks: How many objects can be picked; None draws it.
            places: How many places are free; None draws it.

        Raises:
            PlacementError: The ranges and clearances leave no room after bounded attempts.
            ConfigError: `variant` is unknown, or `picks` or `places` is out of its range.
        """

    @abstractmethod
    def components(self) -> Mapping[str, Component]:
        """Descriptive phrases by their words: `left-most battery` -> check and extract."""

    @abstractmethod
    def geometry(self, obj: ObjectSpec) -> Geometry:
        """The body of one object of a scene, in its own frame.

        It may depend on the object's category, shape, fixedness, label and on whether it takes a
        place; objects that agree in these share one geometry. With a label it may also depend on
        the colour.
        """

    @abstractmethod
    def script(self, view: SceneView, rng: np.random.Generator) -> Iterator[Move]:
        """Yield the moves that take the target object to the target place.

        Each `next` is called after the move before it has ended, so a script may look again.
        """

    @abstractmethod
    def check_success(self, view: SceneView, pairs: Sequence[Pair]) -> Check:
        """Judge the present state: the pair that comes nearest to success, with all conditions."""

    @abstractmethod
    def failure_phase(self, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]) -> str:
        """Name the phase in which an unsuccessful trajectory went wrong."""

    @abstractmethod
    def pads(self, variant: str) -> tuple[Pad, ...]:
        """The sheets that objects of a variant are put on, as they are printed.

        Raises:
            ConfigError: `variant` is unknown.
        """

    @abstractmethod
    def draw_reset(self, scene: SceneSpec) -> Drawing:
        """The picture by which an operator resets the scene."""


TASKS: Registry[type[Task]] = Registry("task")


def get_task(name: str) -> Task:
    """Build a registered task with its own YAML.

    Raises:
        NotRegisteredError: No such task; the message names the closest one.
    """
    import codediffuser.datagen.tasks  # noqa: F401  fills the registry

    return TASKS.get(name)()
