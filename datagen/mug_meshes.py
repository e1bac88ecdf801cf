"""Bodies of mugs: meshes to look at, and the convex parts that collide."""

from __future__ import annotations

import functools
import itertools
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.mug_shapes import HANDLE_SEGMENTS, MugConfig, MugShape
from codediffuser.datagen.shapes import join
from codediffuser.datagen.task import Geometry

if TYPE_CHECKING:
    import trimesh

BODY_SECTIONS = 24
VISUAL_SECTIONS = 32


def mug_geometry(shape: MugShape, config: MugConfig) -> Geometry:
    """A mug that hangs by its handle: the opening is as free to touch as to look at."""
    return Geometry(
        visual=mug_visual(shape),
        collision=mug_parts(shape),
        density_kgm3=config.density_kgm3,
        static_friction=config.friction,
        dynamic_friction=config.friction,
        restitution=0.0,
        angular_damping_per_s=config.angular_damping_per_s,
    )


@functools.lru_cache(maxsize=8)
def mug_parts(shape: MugShape) -> tuple[trimesh.Trimesh, ...]:
    """Convex parts that collide: the body, filled, and the handle as a chain of blocks.

    A hollow body of thin walls would be truer, but fingers that squeeze it sink through its walls.
    """
    return (_body(shape), *_handle_parts(shape))


@functools.lru_cache(maxsize=8)
def mug_visual(shape: MugShape) -> trimesh.Trimesh:
    """The mug as it is looked at: the same outlines, with finer facets."""
    import trimesh

    inner, outer = shape.inner_profile_m(), shape.outer_profile_m()
    floor_z = -shape.height_m / 2 + shape.wall_m
    floor_radius = np.interp(floor_z, inner[:, 1], inner[:, 0])
    profile = np.concatenate(
        [
            [(0.0, -shape.height_m / 2)],
            outer,
            [inner[1], (floor_radius, floor_z), (0.0, floor_z)],
        ]
    )
    body = trimesh.creation.revolve(profile, sections=VISUAL_SECTIONS)
    return join([body, _tube(shape, 2 * HANDLE_SEGMENTS)])


def _body(shape: MugShape) -> trimesh.Trimesh:
    import trimesh

    profile = shape.outer_profile_m()
    angles = np.linspace(0, 2 * np.pi, BODY_SECTIONS, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rings = [np.column_stack([circle * r, np.full(BODY_SECTIONS, z)]) for r, z in profile]
    return trimesh.convex.convex_hull(np.concatenate(rings))


def _handle_parts(shape: MugShape) -> list[trimesh.Trimesh]:
    """Blocks that share their end faces, so that the chain has neither gaps nor overlaps."""
    import trimesh

    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
    sections = _cross_sections(shape, HANDLE_SEGMENTS, corners)
    return [
        trimesh.convex.convex_hull(np.concatenate(pair)) for pair in itertools.pairwise(sections)
    ]


def _tube(shape: MugShape, segments: int) -> trimesh.Trimesh:
    """The handle with rounded edges, for looking at."""
    import trimesh

    angle = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    rounded = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rounded = np.sign(rounded) * np.sqrt(np.abs(rounded)) / 2
    sections = _cross_sections(shape, segments, rounded)
    count = len(rounded)
    first = np.arange(count)
    second = np.roll(first, -1)
    faces = []
    for i in range(segments):
        a, b = i * count, (i + 1) * count
        faces += [np.column_stack([a + first, b + first, a + second])]
        faces += [np.column_stack([a + second, b + first, b + second])]
    mesh = trimesh.Trimesh(sections.reshape(-1, 3), np.concatenate(faces), process=False)
    mesh.fix_normals()
    return mesh


def _cross_sections(shape: MugShape, segments: int, outline: np.ndarray) -> np.ndarray:
    """Outlines (segments + 1, n, 3) of the handle at the points of its middle line.

    Args:
        shape: Of the mug.
        segments: How many pieces the middle line has.
        outline: (n, 2) in units of the handle's thickness and width.
    """
    line = shape.handle_line_m(segments)
    tangent = np.gradient(line, axis=0)
    # Both ends leave the body straight, and so end flat inside its wall.
    tangent[0], tangent[-1] = (1.0, 0.0), (-1.0, 0.0)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    across = outline[:, 0] * shape.handle_thickness_m
    x = line[:, None, 0] + tangent[:, None, 1] * across
    z = line[:, None, 1] - tangent[:, None, 0] * across
    y = np.broadcast_to(outline[:, 1] * shape.handle_width_m, x.shape)
    return np.stack([x, y, z], axis=-1)
