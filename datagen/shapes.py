"""Meshes that tasks build their bodies from, each in its own frame and with exact convex parts.

`trimesh` takes most of a second to import, so it is imported where a mesh is made: drawing and
checking scenes needs none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh


def bevelled_cylinder(
    radius_m: float, height_m: float, bevel_m: float, sections: int = 24
) -> trimesh.Trimesh:
    """Convex cylinder along +z from z = 0, both edges bevelled."""
    import trimesh

    angle = np.linspace(0, 2 * np.pi, sections, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    narrow = radius_m - bevel_m
    rings = [(narrow, 0.0), (radius_m, bevel_m), (radius_m, height_m - bevel_m), (narrow, height_m)]
    points = [np.column_stack([circle * radius, np.full(sections, z)]) for radius, z in rings]
    return trimesh.convex.convex_hull(np.concatenate(points))


def cylinder(radius_m: float, bottom_m: float, height_m: float) -> trimesh.Trimesh:
    """Plain cylinder along +z from `bottom_m`."""
    import trimesh

    lift = np.eye(4)
    lift[2, 3] = bottom_m + height_m / 2
    return trimesh.creation.cylinder(
        radius=radius_m, height=height_m, sections=12, transform=lift
    )  # fmt: skip


def join(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Several meshes as one, for looking at."""
    import trimesh

    return trimesh.util.concatenate(parts)


def crate_parts(
    size_m: tuple[float, float, float], *, rows: int, columns: int, pitch_m: float,
    wall_m: float, floor_m: float, taper_height_m: float, taper_top_m: float,
) -> list[trimesh.Trimesh]:  # fmt: skip
    """Convex parts of a crate of cells, origin at the middle of its underside: floor, then walls.

    Args:
        size_m: Outer extents along x, y, z.
        rows: Cells along y.
        columns: Cells along x.
        pitch_m: Distance between the middles of neighbouring cells.
        wall_m: Thickness of the inner walls below the taper; outer walls reach the outer extents.
        floor_m: Thickness of the floor.
        taper_height_m: How far below the rim the walls begin to narrow.
        taper_top_m: Thickness of the inner walls at the rim.
    """
    import trimesh

    size_x, size_y, height = size_m
    floor = trimesh.creation.box(
        bounds=[[-size_x / 2, -size_y / 2, 0], [size_x / 2, size_y / 2, floor_m]]
    )
    parts = [floor]
    for axis, count, across, along in ((0, columns, size_x, size_y), (1, rows, size_y, size_x)):
        lines = (np.arange(count + 1) - count / 2) * pitch_m
        half, top = wall_m / 2, taper_top_m / 2
        for i, line in enumerate(lines):
            low, high = (line - half, line + half)
            low_top, high_top = (line - top, line + top)
            if i == 0:
                low = low_top = -across / 2
            if i == count:
                high = high_top = across / 2
            parts.append(
                _wall((low, high), (low_top, high_top), along, height, taper_height_m, axis)
            )
    return parts


def _wall(
    bottom: tuple[float, float], top: tuple[float, float], length: float, height: float,
    taper: float, axis: int,
) -> trimesh.Trimesh:  # fmt: skip
    """A wall across `axis` (0 x, 1 y): full width up to the taper, then narrowing to `top`."""
    import trimesh

    corners = []
    for (low, high), z in ((bottom, 0.0), (bottom, height - taper), (top, height)):
        for across in (low, high):
            for along in (-length / 2, length / 2):
                corners.append((across, along, z) if axis == 0 else (along, across, z))
    return trimesh.convex.convex_hull(np.array(corners))
