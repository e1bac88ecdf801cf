"""Mugs of many shapes: a body, and a handle with an opening that a branch passes through.

A mug's frame has its origin in the middle of the body, z up along its axis and the handle along
+x. Nothing here needs a mesh; those are made in `mug_meshes.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np

from codediffuser.datagen import drawing
from codediffuser.datagen.ranges import Range
from codediffuser.datagen.scene import ObjectSpec, Vector3
from codediffuser.poses import apply_transform, invert_transform
from codediffuser.schema import Strict

HANDLE_SEGMENTS = 8
PROFILE_LEVELS = 4
ROUNDING = 0.55
"""Share of the height, from the base, over which a mug narrows: fingers want a straight rim."""


class MugStyle(Strict):
    """Ranges that the sizes of one kind of mug are drawn from; see `MugShape`."""

    height_m: Range
    rim_radius_m: Range
    narrowing_m: Range
    """Of the base against the rim."""
    handle_depth_m: Range
    handle_height_m: Range
    handle_squareness: Range


class MugConfig(Strict):
    """What mugs are made of, and the shapes that they come in."""

    colors: dict[str, Vector3]
    styles: dict[str, MugStyle]
    wall_m: float
    handle_thickness_m: float
    handle_width_m: float
    density_kgm3: float
    """Of the filled body: it makes a mug as heavy as a hollow one of stoneware."""
    friction: float
    angular_damping_per_s: float
    """Stands for what a real mug loses as it swings on its handle: rolling, rattling, air."""


@dataclass(frozen=True, slots=True)
class MugShape:
    """Sizes of one mug; `ObjectSpec.shape` holds the same numbers under the same names."""

    height_m: float
    rim_radius_m: float
    """Outer radius at the rim."""
    base_radius_m: float
    """Outer radius at the base; above `ROUNDING` of the height the outside is straight."""
    wall_m: float
    """Thickness of the wall at base and rim, and of the floor."""
    handle_depth_m: float
    """How far the middle line of the handle stands off the body."""
    handle_height_m: float
    """Distance between the two ends of the handle's middle line."""
    handle_squareness: float
    """Exponent of the handle's outline: 2 is half an ellipse, more is nearer a rectangle."""
    handle_thickness_m: float
    """Of the handle, in the plane of its outline."""
    handle_width_m: float
    """Of the handle, across that plane."""

    @classmethod
    def of(cls, sizes: Mapping[str, float]) -> Self:
        """The shape that an object of a scene stores."""
        return cls(**sizes)

    def sizes(self) -> dict[str, float]:
        """What an object of a scene stores."""
        return asdict(self)

    @property
    def opening_x_m(self) -> tuple[float, float]:
        """From the body's outside to the handle's inside, at half height."""
        outside = float(self._outer_radius_m(np.zeros(1))[0])
        inside = outside - self.wall_m / 2 + self.handle_depth_m - self.handle_thickness_m / 2
        return outside, inside

    @property
    def opening_z_m(self) -> tuple[float, float]:
        """From the inside of the handle's lower arm to that of its upper one."""
        half = (self.handle_height_m - self.handle_thickness_m) / 2
        return -half, half

    def handle_line_m(self, segments: int = HANDLE_SEGMENTS) -> np.ndarray:
        """Middle line of the handle from its lower to its upper end, (segments + 1, 2) x and z.

        Its points are spaced evenly along half a superellipse that stands on the body's wall.
        """
        t = np.linspace(-np.pi / 2, np.pi / 2, 400)
        power = 2 / self.handle_squareness
        z = self.handle_height_m / 2 * np.sign(np.sin(t)) * np.abs(np.sin(t)) ** power
        wall_x = self._outer_radius_m(z) - self.wall_m / 2
        x = wall_x + self.handle_depth_m * np.abs(np.cos(t)) ** power
        run = np.concatenate([[0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))])
        at = np.linspace(0, run[-1], segments + 1)
        return np.stack([np.interp(at, run, x), np.interp(at, run, z)], axis=-1)

    def _outer_radius_m(self, z_m: np.ndarray) -> np.ndarray:
        up = np.clip((z_m / self.height_m + 0.5) / ROUNDING, 0, 1)
        narrowing = self.rim_radius_m - self.base_radius_m
        return np.asarray(self.rim_radius_m - narrowing * (1 - up) ** 2)

    def outer_profile_m(self) -> np.ndarray:
        """Outside of the body from base to rim, (levels, 2) radius and z."""
        up = np.append(np.linspace(0, ROUNDING, PROFILE_LEVELS), 1.0)
        levels = up[[0, -1]] if self.base_radius_m == self.rim_radius_m else up
        z = (levels - 0.5) * self.height_m
        return np.stack([self._outer_radius_m(z), z], axis=-1)

    def inner_profile_m(self) -> np.ndarray:
        """Inside of the wall, straight from base to rim, (2, 2) radius and z."""
        outer = self.outer_profile_m()
        return np.asarray(outer[[0, -1]] - np.array([self.wall_m, 0.0]))

    def lowest_z_m(self, T_world_mug: np.ndarray) -> float:
        """World height of the lowest point of the body, taken as a cylinder of the rim's radius."""
        upright = float(T_world_mug[2, 2])
        reach = abs(upright) * self.height_m / 2 + self.rim_radius_m * np.sqrt(
            1 - min(1, upright**2)
        )
        return float(T_world_mug[2, 3] - reach)


def passes_handle(
    shape: MugShape, T_world_mug: np.ndarray, start_world: np.ndarray, end_world: np.ndarray
) -> bool:
    """Whether a straight line runs through the handle's opening, from one side to the other.

    Args:
        shape: Of the mug.
        T_world_mug: Its pose (4, 4).
        start_world: (3,) one end of the line, m.
        end_world: (3,) the other end.
    """
    ends = apply_transform(invert_transform(T_world_mug), np.stack([start_world, end_world]))
    y0, y1 = ends[:, 1]
    if y0 * y1 >= 0:
        return False
    x, _, z = ends[0] + y0 / (y0 - y1) * (ends[1] - ends[0])
    # The opening is what the handle's middle line and the body enclose; the middle line is convex,
    # so a point lies within when it lies left of every edge on the way around.
    line = shape.handle_line_m()
    edges = np.roll(line, -1, axis=0) - line
    to_point = np.array([x, z]) - line
    return bool(np.all(edges[:, 0] * to_point[:, 1] - edges[:, 1] * to_point[:, 0] > 0))


def draw_mug_shape(rng: np.random.Generator, config: MugConfig) -> MugShape:
    """Draw a style evenly, then each of its sizes evenly, in steps of 0.01 mm."""
    style = config.styles[sorted(config.styles)[rng.integers(len(config.styles))]]
    drawn = {
        name: round(float(rng.uniform(low, high)), 5)
        for name, (low, high) in ((n, getattr(style, n)) for n in MugStyle.model_fields)
    }
    narrowing = drawn.pop("narrowing_m")
    return MugShape(
        **drawn,
        base_radius_m=round(drawn["rim_radius_m"] - narrowing, 5),
        wall_m=config.wall_m,
        handle_thickness_m=config.handle_thickness_m,
        handle_width_m=config.handle_width_m,
    )


def mug_from_above(mug: ObjectSpec, words: str | None) -> list[drawing.Shape]:
    """A mug in a reset picture: a disc of its colour, a blue line for its handle.

    Args:
        mug: Where it stands.
        words: The branch that it goes to, for the one that is taken; None for another.
    """
    shape, T = MugShape.of(mug.shape), mug.T_world_object
    middle = (float(T[0, 3]), float(T[1, 3]))
    end = T[:2, 3] + shape.handle_line_m()[:, 0].max() * T[:2, 0]
    # Paler than the mug: words and the handle's line have to stand out from it.
    pale = tuple(0.2 + 0.8 * channel for channel in mug.color_rgb)
    fill = drawing.display_color(pale)
    edge = drawing.TARGET_EDGE if words else drawing.INK
    painted: list[drawing.Shape] = [
        drawing.Disc(middle, shape.rim_radius_m, fill, edge),
        drawing.Line(middle, (float(end[0]), float(end[1])), drawing.HANDLE, width_pt=3),
    ]
    if words:
        below = (middle[0], middle[1] - shape.rim_radius_m / 3)
        painted.append(drawing.Text(below, words, 9, bold=True, fit_m=1.8 * shape.rim_radius_m))
    return painted
