"""What a task is: how scenes are drawn, what they look like, how to solve and to judge one.

A task is one Python file and one YAML file of the same name in `datagen/tasks/`. It never imports
the simulator: it describes bodies (`Geometry`), motions (`Move`) and conditions (`Check`), and
`sim.py` and `script.py` carry them out.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from codediffuser.datagen.layout import Layout, LayoutRequest, V
from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec
from codediffuser.datagen.task_config import TaskConfig
from codediffuser.errors import ConfigError
from codediffuser.registry import Registry, unknown_name

if TYPE_CHECKING:
    import trimesh

    from codediffuser.datagen.box_row import BoxRow
    from codediffuser.datagen.drawing import Drawing
    from codediffuser.datagen.instructions.components import Component
    from codediffuser.datagen.trajectory import Trajectory


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


C = TypeVar("C", bound=TaskConfig[Any])


class Task(ABC, Generic[C, V]):
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

    row: BoxRow | None = None
    """The row that its objects stand in and whose gaps are its places; most tasks have none."""

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

    def ranges(self, variant: str) -> V:
        """What scenes of a variant are drawn from.

        Raises:
            ConfigError: `variant` is unknown.
        """
        known: dict[str, V] = self.config.variants
        if variant not in known:
            raise ConfigError(unknown_name("variant", variant, list(known)))
        return known[variant]

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
        return self.arrange(rng, LayoutRequest(variant, self.ranges(variant), picks, places))

    def components(self) -> Mapping[str, Component]:
        """Descriptive phrases by their words: `left-most battery` -> check and extract."""
        return self._components

    @functools.cached_property
    def _components(self) -> Mapping[str, Component]:
        return {phrase.words: phrase for phrase in self.phrases()}

    def never_said(self) -> frozenset[str]:
        """Phrases that fit no scene of any variant, by their words: no sentence ever has them.

        Checks of coverage leave them out. They stay among `phrases`, since leaving them out there
        would change which words every scene draws.
        """
        return frozenset()

    @abstractmethod
    def arrange(self, rng: np.random.Generator, asked: LayoutRequest[V]) -> Layout:
        """Draw objects and places as asked: the task's part of `sample_layout`.

        Args:
            rng: The only source of chance.
            asked: Variant with its ranges, and how many picks and places.

        Raises:
            PlacementError: As for `sample_layout`.
            ConfigError: The number of picks or places is out of its range.
        """

    @abstractmethod
    def phrases(self) -> Iterable[Component]:
        """Every descriptive phrase, in the order in which templates list them for a `*`."""

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
