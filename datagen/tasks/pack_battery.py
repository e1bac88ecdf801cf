"""Pick a battery from the table and drop it into a free slot of a crate.

Randomised: how many batteries wait and where, how many slots are taken and which, colours, yaw.
Success: the battery stands in a slot that the instruction allows, released and at rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import model_validator

from codediffuser.datagen import drawing, shapes
from codediffuser.datagen.crate import (
    CrateConfig,
    crate_footprint,
    crate_from_above,
    crate_object,
    crate_slots,
)
from codediffuser.datagen.instructions.components import (
    Component,
    PlaceBand,
    PlaceByDistance,
    extremes,
)
from codediffuser.datagen.layout import Layout, LayoutRequest, drawn_count
from codediffuser.datagen.packing_check import SuccessConfig, check_packed, packing_failure
from codediffuser.datagen.packing_script import ScriptConfig, packing_moves
from codediffuser.datagen.placement import Area, sample_positions
from codediffuser.datagen.ranges import CountRange, Range
from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec, Vector3
from codediffuser.datagen.task import TASKS, Check, Geometry, Move, Pad, SceneView, Task
from codediffuser.datagen.task_config import TaskConfig
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.schema import Strict


class BatteryConfig(Strict):
    """A standing cylinder with bevelled edges; its origin is the middle of its base."""

    radius_m: float
    height_m: float
    bevel_m: float
    waiting_density_kgm3: float
    packed_density_kgm3: float
    colors: dict[str, Vector3]


class VariantConfig(Strict):
    """Ranges that scenes are drawn from."""

    pad_name: str = "pad"
    """What the pad is called on its printed sheets."""
    waiting_count: CountRange
    packed_count: CountRange
    area_x_m: Range
    area_y_m: Range
    min_distance_m: float
    max_tries: int
    max_redraws: int


class LanguageConfig(Strict):
    """How far apart things must be for words to tell them apart."""

    battery_margin_m: float
    """Between an extreme battery ("left-most") and the next one, along the direction."""
    slot_margin_m: float
    """Between the distances of the nearest (furthest) slot and of the next one."""


class PackBatteryConfig(TaskConfig[VariantConfig]):
    """Everything in `pack_battery.yaml`."""

    crate: CrateConfig
    battery: BatteryConfig
    language: LanguageConfig
    success: SuccessConfig
    script: ScriptConfig

    @model_validator(mode="after")
    def _counts_fit(self) -> Self:
        cells = self.crate.rows * self.crate.columns
        for name, variant in self.variants.items():
            (least, most), (fewest, packed) = variant.waiting_count, variant.packed_count
            if not 1 <= least <= most:
                raise ValueError(f"variants.{name}.waiting_count: expected 1 <= low <= high")
            if not 0 <= fewest <= packed < cells:
                raise ValueError(
                    f"variants.{name}.packed_count: expected 0 <= low <= high < {cells}, the "
                    "number of slots, so that one stays free"
                )
        return self


@TASKS.add("pack_battery")
class PackBattery(Task[PackBatteryConfig, VariantConfig]):
    """Put one waiting battery into one free slot."""

    name: ClassVar[str] = "pack_battery"
    config_type: ClassVar[type[TaskConfig]] = PackBatteryConfig
    pick_category: ClassVar[str] = "battery"
    place_category: ClassVar[str] = "slot"

    def arrange(self, rng: np.random.Generator, asked: LayoutRequest[VariantConfig]) -> Layout:
        """Batteries on the table, clear of each other, and others in slots; one slot stays free."""
        crate, ranges = self.config.crate, asked.ranges
        slots = crate_slots(crate)
        low, high = ranges.packed_count
        waiting = drawn_count("picks: waiting batteries", asked.picks, ranges.waiting_count, rng)
        free_range = (len(slots) - high, len(slots) - low)
        packed = len(slots) - drawn_count("places: free slots", asked.places, free_range, rng)
        area = Area(
            ranges.area_x_m, ranges.area_y_m, ranges.min_distance_m, ranges.max_tries,
            ranges.max_redraws, (crate_footprint(crate),), self.config.battery.radius_m,
        )  # fmt: skip
        spots = sample_positions(rng, waiting, area, keys=asked.key, what="waiting batteries")
        taken = [slots[i] for i in sorted(rng.choice(len(slots), size=packed, replace=False))]
        standing = [((float(x), float(y), 0.0), None) for x, y in spots]
        standing += [(slot.position_m, slot.id) for slot in taken]
        objects = [self._battery(rng, i, *spot) for i, spot in enumerate(standing)]
        return Layout((*objects, crate_object(crate)), slots)

    def _battery(
        self, rng: np.random.Generator, number: int, position_m: Vector3, place: str | None
    ) -> ObjectSpec:
        colors = self.config.battery.colors
        color = sorted(colors)[rng.integers(len(colors))]
        half_yaw = rng.uniform(-np.pi / 2, np.pi / 2)
        return ObjectSpec(
            id=f"battery_{number}", category="battery", name=f"{color} battery",
            position_m=position_m, color_rgb=colors[color], place=place,
            quat_wxyz=(float(np.cos(half_yaw)), 0.0, 0.0, float(np.sin(half_yaw))),
        )  # fmt: skip

    def phrases(self) -> Iterable[Component]:
        """Extreme batteries among those that wait; rows and columns of the crate; near and far."""
        side, margins = self.config.observer, self.config.language
        half = self.config.crate.pitch_m / 2
        yield from extremes("battery", side.extremes, margins.battery_margin_m)
        yield PlaceByDistance("furthest slot", "slot", "furthest", margins.slot_margin_m)
        yield PlaceByDistance("nearest slot", "slot", "nearest", margins.slot_margin_m)
        yield PlaceBand("slot on the front-most row", "slot", side.front, "first", half)
        yield PlaceBand("slot on the middle row", "slot", side.front, "inner", half)
        yield PlaceBand("slot on the back-most row", "slot", side.back, "first", half)
        yield PlaceBand("slot on left column", "slot", side.left, "first", half)
        yield PlaceBand("slot on the middle columns", "slot", side.left, "inner", half)
        yield PlaceBand("slot on the right column", "slot", side.right, "first", half)

    def pads(self, variant: str) -> tuple[Pad, ...]:
        """One pad, a margin larger than the area of the batteries' middles."""
        ranges, picture = self.ranges(variant), self.config.reset_image
        margin = picture.pad_margin_m
        low = (ranges.area_x_m[0] - margin, ranges.area_y_m[0] - margin)
        high = (ranges.area_x_m[1] + margin, ranges.area_y_m[1] + margin)
        return (Pad(ranges.pad_name, low, high, picture.cross_spacing_m),)

    def draw_reset(self, scene: SceneSpec) -> drawing.Drawing:
        """Crate and pad from above, the robot at the bottom; the target pair in green."""
        crate, radius = self.config.crate, self.config.battery.radius_m
        (pad,) = self.pads(scene.variant)
        footprint = crate_footprint(crate)
        slot_m = scene.place(scene.target.place).position_m[:2]
        pick_m = scene.object(scene.target.pick).position_m[:2]
        painted = [
            *crate_from_above(crate),
            *drawing.pad_with_crosses(pad),
            drawing.cell(slot_m, crate.pitch_m, crate.wall_m, drawing.TARGET_TINT),
            drawing.arrow_between(pick_m, radius, slot_m, radius),
            drawing.Disc(slot_m, radius, None, drawing.TARGET_EDGE, dashed=True),
            drawing.Text(slot_m, "to here", 9, drawing.TARGET_EDGE, bold=True, fit_m=1.7 * radius),
        ]
        for battery in (o for o in scene.objects if o.category == "battery"):
            at, target = battery.position_m[:2], battery.id == scene.target.pick
            painted.append(drawing.thing(at, radius, target=target))
        painted.append(drawing.Text(pick_m, "take", 9, "#ffffff", True, fit_m=1.7 * radius))
        return drawing.reset_drawing(
            scene, painted, self.config.observer,
            low_m=(min(pad.low_m[0], footprint.x_m[0]), min(pad.low_m[1], footprint.y_m[0])),
            high_m=(max(pad.high_m[0], footprint.x_m[1]), max(pad.high_m[1], footprint.y_m[1])),
            notes=(
                f"{scene.ambiguity.picks} on the pad",
                f"{len(scene.places) - scene.ambiguity.places} in the crate",
            ),
        )  # fmt: skip

    def geometry(self, obj: ObjectSpec) -> Geometry:
        """Crate: floor and tapered walls. Battery: a bevelled cylinder standing on its origin."""
        crate, battery = self.config.crate, self.config.battery
        if obj.category == "crate":
            parts = shapes.crate_parts(
                crate.size_m, rows=crate.rows, columns=crate.columns, pitch_m=crate.pitch_m,
                wall_m=crate.wall_m, floor_m=crate.floor_m,
                taper_height_m=crate.taper_height_m, taper_top_m=crate.taper_top_m,
            )  # fmt: skip
            return Geometry(visual=shapes.join(parts), collision=tuple(parts))
        body = shapes.bevelled_cylinder(battery.radius_m, battery.height_m, battery.bevel_m)
        nub = shapes.cylinder(battery.radius_m / 3, battery.height_m, 0.002)
        waiting = obj.place is None
        return Geometry(
            visual=shapes.join([body, nub]),
            collision=(body,),
            density_kgm3=battery.waiting_density_kgm3 if waiting else battery.packed_density_kgm3,
        )

    def script(self, view: SceneView, rng: np.random.Generator) -> Iterator[Move]:
        """Thirteen moves, from the state as it is seen."""
        return packing_moves(self.config.script, view, rng)

    def check_success(self, view: SceneView, pairs: Sequence[Pair]) -> Check:
        """The supplement's three criteria, and also released and at rest."""
        return check_packed(self.config.success, view, pairs)

    def failure_phase(self, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]) -> str:
        """Phase and what happened in it: `grasp:missed`, `transport:dropped`, `place:on_rim`."""
        pitch_m = self.config.crate.pitch_m
        return packing_failure(self.config.success, pitch_m, scene, trajectory, pairs)
