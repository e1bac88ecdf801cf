"""Ranges of domain randomisation, from a YAML file, and the values drawn from them.

Each section is drawn from an address of its own (`Stage.APPEARANCE`, number of the section): taking
one section out leaves what the others draw as it was.
"""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from codediffuser.datagen.appearance import (
    Appearance,
    CameraOffset,
    DirectionalLight,
    Lights,
    Looks,
    SensorErrors,
)
from codediffuser.datagen.props import PropRanges, draw_props
from codediffuser.datagen.ranges import CountRange, Range
from codediffuser.datagen.scene import SceneSpec, SeedKey, Vector3
from codediffuser.datagen.task import Task
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import ConfigError
from codediffuser.files import sha256_json
from codediffuser.registry import unknown_name
from codediffuser.schema import Document, Strict
from codediffuser.seeding import Stage, rng_for

MAX_LIGHTS = 3
"""Directional lights that SAPIEN's minimal shader takes; it leaves out further ones."""

PRESETS = Path(__file__).parent / "randomizations"


def _few_lights(count: tuple[int, int]) -> tuple[int, int]:
    if not 0 <= count[0] <= count[1] <= MAX_LIGHTS:
        raise ValueError(
            f"expected [low, high] within 0 and {MAX_LIGHTS}, which is all that the shader counts, "
            f"got {list(count)}"
        )
    return count


Share = Annotated[float, Field(ge=0, le=1)]


class LightRanges(Strict):
    """Directional lights from above, and light from everywhere."""

    count: Annotated[tuple[int, int], AfterValidator(_few_lights)]
    ambient: Range
    brightness: Range
    """Of all directional lights together."""
    elevation_rad: Range
    """Above the horizon."""
    tint: Share
    """How far each channel of a light may fall below white."""


class ColorRanges(Strict):
    """A box of linear RGB colours."""

    low_rgb: Vector3
    high_rgb: Vector3
    shown: Share = 1.0
    """How often it is there at all; for pads."""


class CameraRanges(Strict):
    """Cameras that were bumped: each is moved and turned for itself."""

    position_m: float = Field(ge=0)
    """Largest offset along each world axis."""
    rotation_rad: float = Field(ge=0)
    """Largest turn about each world axis."""


class SensorRanges(Strict):
    """Ranges of `SensorErrors`, of which one set holds for an episode."""

    depth_base_m: Range = (0.0, 0.0)
    depth_per_m: Range = (0.0, 0.0)
    drop_probability: Range = (0.0, 0.0)
    edge_drop_probability: Range = (0.0, 0.0)
    holes: CountRange = (0, 0)
    hole_radius: Range = (0.05, 0.05)
    color_noise: Range = (0.0, 0.0)
    color_gain: Range = (1.0, 1.0)


class Randomization(Document):
    """A preset (`schema: codediffuser.randomization/1`). What is left out is not randomised."""

    KIND: ClassVar[str] = "randomization"
    VERSION: ClassVar[int] = 1

    lights: LightRanges | None = None
    table: ColorRanges | None = None
    pad: ColorRanges | None = None
    cameras: CameraRanges | None = None
    props: PropRanges | None = None
    sensor: SensorRanges | None = None

    @property
    def sha256(self) -> str:
        """Of the content, whatever the file is called."""
        return sha256_json(self.model_dump(mode="json", by_alias=True))


class Section(IntEnum):
    """Numbers of the addresses; never reuse or reorder them."""

    LIGHTS = 0
    TABLE = 1
    PAD = 2
    CAMERAS = 3
    PROPS = 4
    SENSOR = 5


def presets() -> list[str]:
    """Names of the presets that ship."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def load_randomization(preset_or_file: str) -> Randomization:
    """Read a preset by its name, or a file by its path.

    Raises:
        ConfigError: There is no such preset or file, or it does not follow the schema.
    """
    if preset_or_file in presets():
        return Randomization.load(PRESETS / f"{preset_or_file}.yaml")
    path = Path(preset_or_file)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return Randomization.load(path)
    raise ConfigError(unknown_name("randomization preset", preset_or_file, presets()))


def draw_appearance(
    ranges: Randomization, name: str, task: Task, scene: SceneSpec, trajectory: Trajectory
) -> Appearance:
    """Draw what an episode looks like; the same scene and trajectory draw the same values.

    Args:
        ranges: What to draw from.
        name: Preset or file name, for the record.
        task: Whose cameras are moved.
        scene: Gives the address, and what props keep clear of.
        trajectory: Props keep clear of everything that moves.
    """
    root, index = scene.seed.root, scene.seed.index

    def rng(section: Section) -> np.random.Generator:
        return rng_for(root, Stage.APPEARANCE, index, section)

    looks = Looks(
        lights=_draw_lights(rng(Section.LIGHTS), ranges.lights),
        table_rgb=_draw_color(rng(Section.TABLE), ranges.table),
        pad_rgb=_draw_color(rng(Section.PAD), ranges.pad),
        cameras=_draw_offsets(rng(Section.CAMERAS), ranges.cameras, task),
        props=draw_props(rng(Section.PROPS), ranges.props, task, scene, trajectory),
        sensor=_draw_sensor(rng(Section.SENSOR), ranges.sensor),
    )
    return Appearance(
        ranges=name,
        ranges_sha256=ranges.sha256,
        seed=SeedKey(root=root, stage=Stage.APPEARANCE.name, index=index, attempt=0),
        looks=looks,
    )


def _draw_lights(rng: np.random.Generator, ranges: LightRanges | None) -> Lights | None:
    if ranges is None:
        return None
    ambient = rng.uniform(*ranges.ambient) * _white(rng, ranges.tint)
    count = int(rng.integers(ranges.count[0], ranges.count[1] + 1))
    shares = rng.dirichlet(np.ones(count)) if count else np.zeros(0)
    brightness = rng.uniform(*ranges.brightness)
    lights = []
    for share in shares:
        azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(*ranges.elevation_rad)
        flat = np.cos(elevation)
        toward = (-flat * np.cos(azimuth), -flat * np.sin(azimuth), -np.sin(elevation))
        color = brightness * share * _white(rng, ranges.tint)
        lights.append(DirectionalLight(direction=_vector(toward), color_rgb=_vector(color)))
    return Lights(ambient_rgb=_vector(ambient), directional=tuple(lights))


def _white(rng: np.random.Generator, tint: float) -> np.ndarray:
    """White (3,) with each channel lowered by up to `tint`."""
    return 1.0 - tint * rng.uniform(size=3)


def _draw_color(rng: np.random.Generator, ranges: ColorRanges | None) -> Vector3 | None:
    if ranges is None or rng.uniform() >= ranges.shown:
        return None
    return _vector(rng.uniform(ranges.low_rgb, ranges.high_rgb))


def _draw_offsets(
    rng: np.random.Generator, ranges: CameraRanges | None, task: Task
) -> dict[str, CameraOffset]:
    if ranges is None:
        return {}
    return {
        view.name: CameraOffset(
            position_m=_vector(rng.uniform(-1, 1, 3) * ranges.position_m),
            rotation_rad=_vector(rng.uniform(-1, 1, 3) * ranges.rotation_rad),
        )
        for view in task.config.cameras.views
    }


def _draw_sensor(rng: np.random.Generator, ranges: SensorRanges | None) -> SensorErrors | None:
    if ranges is None:
        return None
    return SensorErrors(
        depth_base_m=rng.uniform(*ranges.depth_base_m),
        depth_per_m=rng.uniform(*ranges.depth_per_m),
        drop_probability=rng.uniform(*ranges.drop_probability),
        edge_drop_probability=rng.uniform(*ranges.edge_drop_probability),
        holes=int(rng.integers(ranges.holes[0], ranges.holes[1] + 1)),
        hole_radius=rng.uniform(*ranges.hole_radius),
        color_noise=rng.uniform(*ranges.color_noise),
        color_gain=_vector(rng.uniform(*ranges.color_gain, size=3)),
    )


def _vector(values: np.ndarray | tuple[float, float, float]) -> Vector3:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
