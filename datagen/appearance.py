"""What one episode looks like beside its scene: lights, colours, cameras, props, sensor errors.

`Looks` are drawn values, no ranges: with the scene and the states they give the same pictures
again. Nothing in it touches physics.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from codediffuser.datagen.cameras import T_world_camera
from codediffuser.datagen.scene import QuatWxyz, SeedKey, Vector3
from codediffuser.datagen.task_config import CameraConfig, CameraView
from codediffuser.schema import Document, Strict

APPEARANCE = "appearance.json"
"""File name in an episode folder; absent when nothing was randomised."""


class DirectionalLight(Strict):
    """Parallel light without shadows."""

    direction: Vector3
    """Where it shines to, any length, world."""
    color_rgb: Vector3
    """Linear, with the brightness in it: about 1 for a main light."""


class Lights(Strict):
    """All light of a scene."""

    ambient_rgb: Vector3
    directional: tuple[DirectionalLight, ...]


class CameraOffset(Strict):
    """How far a camera stands from where the task's YAML puts it."""

    position_m: Vector3
    """World."""
    rotation_rad: Vector3
    """Rotation vector about the camera's centre, world axes."""


class Prop(Strict):
    """A thing that only looks: it lies where nothing of the episode ever comes."""

    shape: Literal["box", "cylinder", "sphere"]
    size_m: Vector3
    """Full extents; a cylinder's and a sphere's first entry is the diameter."""
    position_m: Vector3
    """Middle, world."""
    quat_wxyz: QuatWxyz
    color_rgb: Vector3


class SensorErrors(Strict):
    """How pictures differ from ideal ones. Single errors come from `Stage.SENSOR` addresses."""

    depth_base_m: float = Field(ge=0)
    depth_per_m: float = Field(ge=0)
    """Standard deviation of depth z in metres: `depth_base_m + depth_per_m * z**2`."""
    drop_probability: float = Field(ge=0, le=1)
    """Chance of a pixel to have no depth reading."""
    edge_drop_probability: float = Field(ge=0, le=1)
    """The same beside a jump in depth."""
    holes: int = Field(ge=0)
    """Round regions without reading, in each picture."""
    hole_radius: float = Field(ge=0, le=1)
    """Of such a region, as a share of the picture's height."""
    color_noise: float = Field(ge=0)
    """Standard deviation of each colour value, of 255."""
    color_gain: Vector3
    """Factor on red, green and blue."""


class Looks(Strict):
    """What pictures show beside the scene; the default is the usual look, with perfect sensors."""

    lights: Lights | None = None
    """None keeps the usual lights."""
    table_rgb: Vector3 | None = None
    """None keeps the usual colour."""
    pad_rgb: Vector3 | None = None
    """Colour of the task's pads; None shows none."""
    cameras: dict[str, CameraOffset] = Field(default_factory=dict)
    props: tuple[Prop, ...] = ()
    sensor: SensorErrors | None = None

    def move_cameras(self, config: CameraConfig) -> CameraConfig:
        """Cameras where they really stand; those without an offset stay."""
        return config.model_copy(update={"views": tuple(self._move(view) for view in config.views)})

    def _move(self, view: CameraView) -> CameraView:
        offset = self.cameras.get(view.name)
        if offset is None:
            return view
        turn = Rotation.from_rotvec(offset.rotation_rad).as_matrix()
        R = turn @ T_world_camera(view)[:3, :3]
        return view.model_copy(
            update={
                "position_m": tuple(np.add(view.position_m, offset.position_m).tolist()),
                "right": tuple(R[:, 0].tolist()),
                "look": tuple(R[:, 2].tolist()),
            }
        )


class Appearance(Document):
    """`appearance.json` (`schema: codediffuser.appearance/1`): looks, and where they come from."""

    KIND: ClassVar[str] = "appearance"
    VERSION: ClassVar[int] = 1

    ranges: str
    """Preset or file name that the values were drawn from."""
    ranges_sha256: str
    """Of its content."""
    seed: SeedKey
    """Address of the generators that drew the values; the attempt counts the sections."""
    looks: Looks
