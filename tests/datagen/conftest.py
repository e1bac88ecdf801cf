"""Builders for scenes; no simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from codediffuser.datagen.crate import crate_object, crate_slots
from codediffuser.datagen.scene import ObjectSpec, SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import Layout
from codediffuser.datagen.tasks.pack_battery import PackBattery


@pytest.fixture(scope="session")
def pack_battery() -> PackBattery:
    """The task with the YAML that ships."""
    return PackBattery()


@pytest.fixture(scope="session")
def scenes(pack_battery: PackBattery) -> list[SceneSpec]:
    """Three hundred scenes of pack_battery."""
    return [sample_scene(pack_battery, root_seed=7, index=i) for i in range(300)]


@pytest.fixture(scope="session")
def make_layout(pack_battery: PackBattery) -> Callable[..., Layout]:
    """Batteries `battery_0`, ... waiting at given xy, and the given slots free (others taken)."""
    crate = pack_battery.config.crate
    slots = crate_slots(crate)

    def make(waiting: Sequence[tuple[float, float]], free: Sequence[int] | None = None) -> Layout:
        free = range(len(slots)) if free is None else free
        spots = [((x, y, 0.0), None) for x, y in waiting]
        spots += [(s.position_m, s.id) for i, s in enumerate(slots) if i not in free]
        batteries = [
            ObjectSpec(
                id=f"battery_{i}", category="battery", name="green battery",
                position_m=position, color_rgb=(0.2, 0.5, 0.2), place=place,
            )
            for i, (position, place) in enumerate(spots)
        ]  # fmt: skip
        return Layout((*batteries, crate_object(crate)), slots)

    return make
