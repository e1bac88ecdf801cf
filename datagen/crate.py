"""A crate of cells: its sizes, where its slots are, and how it looks from above."""

from __future__ import annotations

from codediffuser.datagen.drawing import Shape, grid_of_cells
from codediffuser.datagen.placement import KeepOut
from codediffuser.datagen.scene import ObjectSpec, PlaceSpec, Vector3
from codediffuser.schema import Strict


class CrateConfig(Strict):
    """A crate of rows x columns cells; row 0 is farthest (+y), column 0 rightmost (+x)."""

    position_m: Vector3
    """Middle of the underside."""
    size_m: Vector3
    color_rgb: Vector3
    rows: int
    columns: int
    pitch_m: float
    wall_m: float
    floor_m: float
    taper_height_m: float
    taper_top_m: float


def slot_position_m(crate: CrateConfig, index: int) -> Vector3:
    """World position of the middle of a slot's floor; index = columns * row + column."""
    row, column = divmod(index, crate.columns)
    x = crate.position_m[0] + ((crate.columns - 1) / 2 - column) * crate.pitch_m
    y = crate.position_m[1] + ((crate.rows - 1) / 2 - row) * crate.pitch_m
    return (x, y, crate.position_m[2] + crate.floor_m)


def crate_slots(crate: CrateConfig) -> tuple[PlaceSpec, ...]:
    """All slots, `slot_00`, `slot_01`, ...; each region is a cell from the table to the rim."""
    height = crate.size_m[2]
    slots = []
    for index in range(crate.rows * crate.columns):
        x, y, z = slot_position_m(crate, index)
        slots.append(
            PlaceSpec(
                id=f"slot_{index:02d}",
                category="slot",
                position_m=(x, y, z),
                size_m=(crate.pitch_m, crate.pitch_m, height),
                center_m=(x, y, crate.position_m[2] + height / 2),
            )
        )
    return tuple(slots)


def crate_object(crate: CrateConfig) -> ObjectSpec:
    """The crate itself, which does not move."""
    return ObjectSpec(
        id="crate",
        category="crate",
        name="crate",
        position_m=crate.position_m,
        color_rgb=crate.color_rgb,
        fixed=True,
    )


def crate_footprint(crate: CrateConfig) -> KeepOut:
    """The part of the table that the crate covers."""
    (x, y, _), (size_x, size_y, _) = crate.position_m, crate.size_m
    return KeepOut("the crate", (x - size_x / 2, x + size_x / 2), (y - size_y / 2, y + size_y / 2))


def crate_from_above(crate: CrateConfig) -> list[Shape]:
    """The crate in a reset picture: grey, with white cells."""
    return grid_of_cells(
        crate.position_m[:2], crate.size_m[:2], crate.rows, crate.columns, crate.pitch_m,
        crate.wall_m,
    )  # fmt: skip
