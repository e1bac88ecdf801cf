"""Builders for scenes, and the simulators that several tests share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import pytest

from codediffuser.datagen.crate import crate_object, crate_slots
from codediffuser.datagen.layout import Layout
from codediffuser.datagen.scene import ObjectSpec, SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.tasks.pack_battery import PackBattery

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.rendering import Renderer
    from codediffuser.datagen.script import ExpertRun


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


@pytest.fixture(scope="session")
def physics(pack_battery: PackBattery, scenes: list[SceneSpec]) -> SceneEnv:
    """Physics of pack_battery without a renderer; every test resets it."""
    from codediffuser.datagen.envs import physics_env

    return physics_env(pack_battery, scenes[0])


@pytest.fixture(scope="session")
def expert_run(physics: SceneEnv, scenes: list[SceneSpec]) -> ExpertRun:
    """One demonstration, in the first scene."""
    import numpy as np

    from codediffuser.datagen.script import run_expert

    return run_expert(physics, scenes[0], np.random.default_rng(0))


@pytest.fixture(scope="session")
def small_renderer(pack_battery: PackBattery) -> Renderer:
    """All cameras at 160x120; every test sets its scene."""
    from codediffuser.datagen.rendering import Renderer

    cameras = pack_battery.config.cameras.model_copy(update={"width": 160, "height": 120})
    return Renderer(pack_battery, cameras)
