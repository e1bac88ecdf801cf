"""Many scenes side by side with one fixed set of bodies, as parallel simulators want them.

A parallel simulator builds its bodies once and resets by moving them. Scenes of one task differ in
how many objects of which shape they have, so every scene of a batch gets a slot for each body that
any of them needs; what a scene does not have is parked on the floor, far from the table. States of
a batch are plain arrays with one row per scene and one column per slot.

PhysX on the CPU holds one scene per environment, so `SceneBatch` steps several environments; slots,
parking and arrays are what a GPU backend would use as they are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.scene import ObjectSpec, SceneSpec
from codediffuser.datagen.task import Check, Task
from codediffuser.datagen.views import Moment, MomentView
from codediffuser.errors import ConfigError, ShapeError

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv

PARK_X_M, PARK_Y_M, PARK_STEP_M = (1.6, 3.6), (-3.0, 3.0), 0.5
"""Where bodies are parked on the floor, and how far apart."""


@dataclass(frozen=True, slots=True, order=True)
class BodyKind:
    """What makes two bodies exchangeable: they share geometry and mass."""

    category: str
    shape: tuple[tuple[str, float], ...]
    fixed: bool
    placed: bool
    """Whether it takes a place at the start; its mass may depend on it."""


@dataclass(frozen=True, slots=True)
class Slots:
    """The fixed set of bodies of a batch, and who takes which."""

    kinds: tuple[BodyKind, ...]
    """(n_slots,)."""
    templates: tuple[ObjectSpec, ...]
    """(n_slots,) one object of each kind."""
    slot_of: tuple[dict[str, int], ...]
    """For each scene: object id to slot."""

    @property
    def movable(self) -> np.ndarray:
        """(n_slots,) bool: bodies that have a state."""
        return np.array([not kind.fixed for kind in self.kinds])


@dataclass(frozen=True, slots=True)
class BatchState:
    """States of B scenes; parked bodies keep their parking place."""

    position_m: np.ndarray
    """(B, n_slots, 3) float64, world of each scene."""
    quat_wxyz: np.ndarray
    """(B, n_slots, 4) float64."""
    velocity: np.ndarray
    """(B, n_slots, 6) float64: linear m/s, then angular rad/s."""
    present: np.ndarray
    """(B, n_slots) bool: bodies that belong to the scene; the others are parked."""
    qpos: np.ndarray
    """(B, 9) float64."""
    qvel: np.ndarray
    """(B, 9) float64."""
    hand_position_m: np.ndarray
    """(B, 3) float64."""
    hand_quat_wxyz: np.ndarray
    """(B, 4) float64."""


def body_kind(obj: ObjectSpec) -> BodyKind:
    """The kind of an object."""
    sizes = tuple(sorted(obj.shape.items()))
    return BodyKind(obj.category, sizes, obj.fixed, obj.place is not None)


def common_slots(scenes: Sequence[SceneSpec]) -> Slots:
    """The smallest set of bodies that holds every one of the scenes.

    Raises:
        ConfigError: There are no scenes, or they are of several tasks.
    """
    if len({scene.task for scene in scenes}) != 1:
        raise ConfigError(
            f"a batch needs scenes of one task, got {sorted({s.task for s in scenes}) or 'none'}"
        )
    needed: Counter[BodyKind] = Counter()
    templates: dict[BodyKind, ObjectSpec] = {}
    for scene in scenes:
        needed |= Counter(body_kind(obj) for obj in scene.objects)
        templates |= {body_kind(obj): obj for obj in scene.objects}
    kinds = tuple(sorted(needed.elements()))
    first = {kind: kinds.index(kind) for kind in needed}
    slot_of = []
    for scene in scenes:
        taken: Counter[BodyKind] = Counter()
        slots = {}
        for obj in scene.objects:
            kind = body_kind(obj)
            slots[obj.id] = first[kind] + taken[kind]
            taken[kind] += 1
        slot_of.append(slots)
    return Slots(kinds, tuple(templates[kind] for kind in kinds), tuple(slot_of))


def pad_scene(task: Task, scene: SceneSpec, slots: Slots, row: int) -> SceneSpec:
    """The scene with all bodies of the batch, in the order of the slots, absent ones parked."""
    by_slot = {slots.slot_of[row][obj.id]: obj for obj in scene.objects}
    objects = [by_slot.get(i) or _parked(task, slots, i) for i in range(len(slots.kinds))]
    return scene.model_copy(update={"objects": tuple(objects)})


def _parked(task: Task, slots: Slots, slot: int) -> ObjectSpec:
    template = slots.templates[slot]
    across = int((PARK_X_M[1] - PARK_X_M[0]) / PARK_STEP_M) + 1
    x = PARK_X_M[0] + slot % across * PARK_STEP_M
    y = PARK_Y_M[0] + slot // across * PARK_STEP_M
    if y > PARK_Y_M[1]:
        raise ConfigError(f"a batch of {len(slots.kinds)} bodies has no parking place for all")
    from codediffuser.datagen.sim import GROUND_Z_M

    lowest = float(task.geometry(template).visual.bounds[0, 2])
    return template.model_copy(
        update={
            "id": f"parked_{slot}",
            "position_m": (x, y, GROUND_Z_M - lowest),
            "quat_wxyz": (1.0, 0.0, 0.0, 0.0),
            "place": None,
        }
    )


def stack_moments(padded: Sequence[SceneSpec], moments: Sequence[Moment]) -> BatchState:
    """Join the states of padded scenes, whose rows are their movable bodies, to arrays.

    Raises:
        ShapeError: A state does not have a row for every movable body of its scene.
    """
    count = len(padded[0].objects)
    position, quat = np.zeros((len(padded), count, 3)), np.zeros((len(padded), count, 4))
    velocity = np.zeros((len(padded), count, 6))
    for i, (scene, moment) in enumerate(zip(padded, moments, strict=True)):
        position[i] = [obj.position_m for obj in scene.objects]
        quat[i] = [obj.quat_wxyz for obj in scene.objects]
        movable = [k for k, obj in enumerate(scene.objects) if not obj.fixed]
        if len(movable) != len(moment.object_position_m):
            raise ShapeError(
                f"scene {scene.scene_id}: expected states of {len(movable)} bodies, got "
                f"{len(moment.object_position_m)}"
            )
        position[i, movable] = moment.object_position_m
        quat[i, movable] = moment.object_quat_wxyz
        velocity[i, movable] = moment.object_velocity
    present = [[not obj.id.startswith("parked_") for obj in s.objects] for s in padded]
    return BatchState(
        position_m=position,
        quat_wxyz=quat,
        velocity=velocity,
        present=np.array(present),
        qpos=np.stack([m.qpos for m in moments]),
        qvel=np.stack([m.qvel for m in moments]),
        hand_position_m=np.stack([m.hand_position_m for m in moments]),
        hand_quat_wxyz=np.stack([m.hand_quat_wxyz for m in moments]),
    )


def moment_of(batch: BatchState, slots: Slots, scene: SceneSpec, row: int) -> Moment:
    """The state of one scene of a batch as that scene alone would have it."""
    chosen = [slots.slot_of[row][obj.id] for obj in scene.objects if not obj.fixed]
    return Moment(
        object_position_m=batch.position_m[row, chosen],
        object_quat_wxyz=batch.quat_wxyz[row, chosen],
        object_velocity=batch.velocity[row, chosen],
        qpos=batch.qpos[row],
        qvel=batch.qvel[row],
        hand_position_m=batch.hand_position_m[row],
        hand_quat_wxyz=batch.hand_quat_wxyz[row],
    )


class SceneBatch:
    """Steps B scenes of one task with one fixed set of bodies, on the CPU one after another.

    Args:
        task: Whose scenes they are.
        scenes: B scenes; their bodies fix the slots.
    """

    def __init__(self, task: Task, scenes: Sequence[SceneSpec]) -> None:
        from codediffuser.datagen.envs import physics_env

        self.task = task
        self.scenes = tuple(scenes)
        self.slots = common_slots(scenes)
        self.padded = tuple(
            pad_scene(task, scene, self.slots, row) for row, scene in enumerate(scenes)
        )
        self._envs: list[SceneEnv] = [physics_env(task, scene) for scene in self.padded]

    def reset(self) -> BatchState:
        """Bring all scenes back to their start."""
        for env, scene in zip(self._envs, self.padded, strict=True):
            env.reset(options={"scene": scene})
        return self.state()

    def step(self, actions: np.ndarray) -> BatchState:
        """Do one control step in every scene.

        Args:
            actions: (B, 10) float32, see `ACTION_NAMES`.

        Raises:
            ShapeError: There is not one action per scene.
        """
        if actions.shape != (len(self._envs), 10):
            raise ShapeError(
                f"actions: expected shape {(len(self._envs), 10)}, got {actions.shape}"
            )
        for env, action in zip(self._envs, actions, strict=True):
            env.control_step(action)
        return self.state()

    def state(self) -> BatchState:
        """The present states."""
        return stack_moments(self.padded, [env.view.moment() for env in self._envs])

    def checks(self) -> list[Check]:
        """Success of every scene by its own instruction."""
        batch = self.state()
        found = []
        for row, scene in enumerate(self.scenes):
            ids = [obj.id for obj in scene.objects if not obj.fixed]
            view = MomentView(scene, ids, moment_of(batch, self.slots, scene, row))
            found.append(self.task.check_success(view, scene.instruction.pairs))
        return found
