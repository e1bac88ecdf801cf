"""Pick a battery from the table and drop it into a free slot of a crate.

Randomised: how many batteries wait and where, how many slots are taken and which, colours, yaw.
Success: the battery stands in a slot that the instruction allows, released and at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np
import trimesh

from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec, Vector3
from codediffuser.datagen.task import (
    TASKS,
    Check,
    Condition,
    Geometry,
    Move,
    SceneView,
    Task,
    TaskConfig,
)
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.poses import make_transform, rotation_z
from codediffuser.schema import Strict

R_WORLD_HAND_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""The hand points down and its fingers open along world x."""


class CrateConfig(Strict):
    """A crate of rows x columns cells; row 0 is farthest (+y), column 0 rightmost (+x)."""

    position_m: Vector3
    size_m: Vector3
    color_rgb: Vector3
    rows: int
    columns: int
    pitch_m: float
    wall_m: float
    floor_m: float
    taper_height_m: float
    taper_top_m: float


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

    waiting_count: tuple[int, int]
    packed_count: tuple[int, int]
    area_x_m: tuple[float, float]
    area_y_m: tuple[float, float]
    min_distance_m: float
    max_tries: int
    max_redraws: int


class SuccessConfig(Strict):
    """Thresholds of `check_success`."""

    max_xy_m: float
    min_upright: float
    max_base_height_m: float
    min_opening_m: float
    min_hand_distance_m: float
    max_speed_mps: float
    max_spin_radps: float


class ScriptConfig(Strict):
    """Heights of the hand above the table, and how much each demonstration varies."""

    travel_z_m: float
    pregrasp_z_m: float
    grasp_z_m: float
    prerelease_z_m: float
    release_z_m: float
    home_m: Vector3
    open_m: float
    noise_xy_m: float
    noise_yaw_rad: float


class PackBatteryConfig(TaskConfig):
    """Everything in `pack_battery.yaml`."""

    crate: CrateConfig
    battery: BatteryConfig
    variants: dict[str, VariantConfig]
    success: SuccessConfig
    script: ScriptConfig


@TASKS.add("pack_battery")
class PackBattery(Task[PackBatteryConfig]):
    """Put one waiting battery into one free slot."""

    name: ClassVar[str] = "pack_battery"
    config_type: ClassVar[type[TaskConfig]] = PackBatteryConfig
    pick_category: ClassVar[str] = "battery"
    place_category: ClassVar[str] = "slot"

    def geometry(self, obj: ObjectSpec) -> Geometry:
        """Crate: floor and tapered walls. Battery: a bevelled cylinder standing on its origin."""
        if obj.category == "crate":
            parts = crate_parts(self.config.crate)
            return Geometry(visual=trimesh.util.concatenate(parts), collision=tuple(parts))
        battery = self.config.battery
        body = battery_body(battery)
        nub = trimesh.creation.cylinder(
            radius=battery.radius_m / 3, height=0.002, sections=12,
            transform=make_transform(np.eye(3), np.array([0, 0, battery.height_m + 0.001])),
        )  # fmt: skip
        waiting = obj.place is None
        return Geometry(
            visual=trimesh.util.concatenate([body, nub]),
            collision=(body,),
            density_kgm3=battery.waiting_density_kgm3 if waiting else battery.packed_density_kgm3,
        )

    def script(self, view: SceneView, rng: np.random.Generator) -> Iterator[Move]:
        """The thirteen phases of the reference, 185 control steps, from the state as it is seen."""
        s, scene = self.config.script, view.scene
        travel, low, closed = s.travel_z_m, s.pregrasp_z_m, 0.0

        def noise(scale: float) -> np.ndarray:
            xy = rng.uniform(-1, 1, size=2) * s.noise_xy_m * scale
            return np.array([xy[0], xy[1], rng.uniform(-1, 1) * s.noise_yaw_rad])

        def hand(xy: np.ndarray, z: float, offset: np.ndarray | None = None) -> np.ndarray:
            dx, dy, yaw = offset if offset is not None else (0.0, 0.0, 0.0)
            R = rotation_z(yaw) @ R_WORLD_HAND_DOWN
            return make_transform(R, np.array([xy[0] + dx, xy[1] + dy, z]))

        battery = view.T_world_object(scene.target.pick)[:2, 3]
        slot = np.array(scene.place(scene.target.place).position_m[:2])
        home = make_transform(R_WORLD_HAND_DOWN, np.array(s.home_m))

        yield Move("approach", hand(battery, travel, noise(3)), 15, s.open_m)
        yield Move("approach", hand(battery, low), 10, s.open_m)
        yield Move("descend", hand(battery, s.grasp_z_m), 15, s.open_m)
        yield Move("grasp", hand(battery, s.grasp_z_m), 10, closed)
        yield Move("grasp", hand(battery, s.grasp_z_m), 5, closed)
        yield Move("lift", hand(battery, travel, noise(1)), 15, closed)
        yield Move("transport", hand(slot, travel, noise(2)), 30, closed)
        yield Move("lower", hand(slot, s.prerelease_z_m), 15, closed)
        yield Move("lower", hand(slot, s.release_z_m), 15, closed)
        yield Move("release", hand(slot, s.release_z_m), 10, s.open_m)
        yield Move("retreat", hand(slot, travel, noise(1)), 15, s.open_m)
        yield Move("home", home, 15, s.open_m)
        yield Move("home", home, 15, s.open_m)

    def check_success(self, view: SceneView, pairs: Sequence[Pair]) -> Check:
        """The supplement's three criteria, and also released and at rest."""
        judged = [Check(pair, self._conditions(view, pair)) for pair in pairs]
        if not judged:
            return Check(None, ())
        return max(
            judged, key=lambda c: (sum(x.holds for x in c.conditions), -c.conditions[0].value)
        )

    def _conditions(self, view: SceneView, pair: Pair) -> tuple[Condition, ...]:
        limits = self.config.success
        T = view.T_world_object(pair[0])
        slot = np.array(view.scene.place(pair[1]).position_m)
        xy = float(np.linalg.norm(T[:2, 3] - slot[:2]))
        upright, height = float(T[2, 2]), float(T[2, 3])
        opening = view.gripper_opening_m()
        hand_away = float(np.linalg.norm(view.T_world_hand()[:3, 3] - T[:3, 3]))
        speed, spin = view.object_speed(pair[0])
        released = opening > limits.min_opening_m or hand_away > limits.min_hand_distance_m
        return (
            Condition("xy_distance_m", xy, limits.max_xy_m, xy < limits.max_xy_m),
            Condition("upright", upright, limits.min_upright, upright > limits.min_upright),
            Condition(
                "base_height_m", height, limits.max_base_height_m, height < limits.max_base_height_m
            ),
            Condition("released_opening_m", opening, limits.min_opening_m, released),
            Condition("speed_mps", speed, limits.max_speed_mps, speed < limits.max_speed_mps),
            Condition("spin_radps", spin, limits.max_spin_radps, spin < limits.max_spin_radps),
        )

    def failure_phase(self, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]) -> str:
        """Phase and what happened in it: `grasp:missed`, `transport:dropped`, `place:on_rim`, ..."""
        limits = self.config.success
        positions = trajectory.object_position_m
        rise = (positions[:, :, 2] - positions[0, :, 2]).max(axis=0)
        waiting = [o.id for o in scene.pickable]
        lifted = [i for i in waiting if rise[trajectory.object_ids.index(i)] > 0.03]
        wanted = {pick for pick, _ in pairs}
        if not lifted:
            ends = [trajectory.T_world_object(i, -1)[2, 2] for i in waiting]
            return "grasp:tipped" if min(ends) < 0.9 else "grasp:missed"
        handled = max(lifted, key=lambda i: rise[trajectory.object_ids.index(i)])
        if handled not in wanted:
            return "grasp:wrong_object"
        T = trajectory.T_world_object(handled, -1)
        hand_away = np.linalg.norm(trajectory.T_world_hand(-1)[:3, 3] - T[:3, 3])
        opening = float(trajectory.qpos[-1, 7:].mean())
        if hand_away < limits.min_hand_distance_m and opening < limits.min_opening_m:
            return "transport:timeout" if T[2, 3] > 0.05 else "release:not_released"
        distances = {
            p.id: float(np.linalg.norm(T[:2, 3] - np.array(p.position_m[:2]))) for p in scene.places
        }
        nearest = min(distances, key=lambda name: distances[name])
        if distances[nearest] > self.config.crate.pitch_m:
            return "transport:dropped"
        if T[2, 3] >= limits.max_base_height_m or T[2, 2] <= limits.min_upright:
            return "place:on_rim"
        return "place:wrong_slot" if (handled, nearest) not in pairs else "release:not_at_rest"


def slot_center_m(crate: CrateConfig, index: int) -> Vector3:
    """World position of the middle of a slot's floor; index = columns * row + column."""
    row, column = divmod(index, crate.columns)
    x = crate.position_m[0] + ((crate.columns - 1) / 2 - column) * crate.pitch_m
    y = crate.position_m[1] + ((crate.rows - 1) / 2 - row) * crate.pitch_m
    return (x, y, crate.position_m[2] + crate.floor_m)


def battery_body(battery: BatteryConfig, sections: int = 24) -> trimesh.Trimesh:
    """Convex cylinder along +z from z = 0, both edges bevelled."""
    angle = np.linspace(0, 2 * np.pi, sections, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    r, h, b = battery.radius_m, battery.height_m, battery.bevel_m
    rings = [(r - b, 0.0), (r, b), (r, h - b), (r - b, h)]
    points = [np.column_stack([circle * radius, np.full(sections, z)]) for radius, z in rings]
    return trimesh.convex.convex_hull(np.concatenate(points))


def crate_parts(crate: CrateConfig) -> list[trimesh.Trimesh]:
    """Convex parts of the crate, origin at the middle of its underside: floor, then walls."""
    size_x, size_y, height = crate.size_m
    floor = trimesh.creation.box(
        bounds=[[-size_x / 2, -size_y / 2, 0], [size_x / 2, size_y / 2, crate.floor_m]]
    )
    parts = [floor]
    for axis, count, across, along in (
        (0, crate.columns, size_x, size_y),
        (1, crate.rows, size_y, size_x),
    ):
        lines = (np.arange(count + 1) - count / 2) * crate.pitch_m
        half, top = crate.wall_m / 2, crate.taper_top_m / 2
        for i, line in enumerate(lines):
            low, high = (line - half, line + half)
            low_top, high_top = (line - top, line + top)
            if i == 0:
                low = low_top = -across / 2
            if i == count:
                high = high_top = across / 2
            parts.append(
                _wall((low, high), (low_top, high_top), along, height, crate.taper_height_m, axis)
            )
    return parts


def _wall(
    bottom: tuple[float, float], top: tuple[float, float], length: float, height: float,
    taper: float, axis: int,
) -> trimesh.Trimesh:  # fmt: skip
    """A wall across `axis` (0 x, 1 y): full width up to the taper, then narrowing to `top`."""
    corners = []
    for (low, high), z in ((bottom, 0.0), (bottom, height - taper), (top, height)):
        for across in (low, high):
            for along in (-length / 2, length / 2):
                corners.append((across, along, z) if axis == 0 else (along, across, z))
    return trimesh.convex.convex_hull(np.array(corners))
