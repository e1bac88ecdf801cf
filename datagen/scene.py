"""The scene file: which objects lie where, what the demonstration targets, what is asked.

A `SceneSpec` is plain data. Sampling, drawing and checking one needs no simulator.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from codediffuser.poses import pose_to_transform
from codediffuser.schema import Document, Raw, Strict

Vector3 = tuple[float, float, float]
QuatWxyz = tuple[float, float, float, float]
TemplateSplit = Literal["seen", "unseen"]
"""Unseen sentences are kept out of training, to test with."""
Pair = tuple[str, str]
"""Ids of an object and of the place that it goes to."""

SCENES = "scenes"
"""Folder of the scenes in a run."""

Split = Literal["all", "train", "val", "held_out", "eval"]
"""Part of the configuration space that a scene was drawn from, see `configuration_split.py`; `all`
and `eval` are the whole of it."""


class ObjectSpec(Strict):
    """One body of the scene."""

    id: str
    category: str
    """What kind of thing it is: `battery`, `crate`. Language and perception use the same word."""
    name: str
    """What a person would call it: `green battery`."""
    position_m: Vector3
    """Origin of the body in the world."""
    quat_wxyz: QuatWxyz = (1.0, 0.0, 0.0, 0.0)
    color_rgb: Vector3
    """Linear RGB in [0, 1]."""
    fixed: bool = False
    """Whether the body cannot move."""
    place: str | None = None
    """Id of the place that it already takes; None for an object that may be picked."""
    shape: dict[str, float] = Field(default_factory=dict)
    """Sizes that the task draws the geometry from, with units in the keys."""
    label: str | None = None
    """What is written on it: the title of a book."""

    @property
    def T_world_object(self) -> np.ndarray:
        """Pose (4, 4) float64 at reset."""
        return pose_to_transform(np.array(self.position_m), np.array(self.quat_wxyz))


class PlaceSpec(Strict):
    """One place that an object can be put to: a slot, a branch, a gap."""

    id: str
    category: str
    position_m: Vector3
    """Where the origin of a well-placed object comes to stand, in the world."""
    size_m: Vector3
    """Extent of the place along the world axes: the region whose points belong to it."""
    center_m: Vector3
    """Middle of that region."""


class Target(Strict):
    """What the demonstration does."""

    pick: str
    place: str


class Ambiguity(Strict):
    """How many objects could be picked and how many places could take one, before any words."""

    picks: int
    places: int


class InstructionSpec(Strict):
    """A sentence with all that it allows."""

    text: str
    kind: str
    """Slackness kind: `no_slackness`, `battery_slackness`, ..."""
    template_id: str
    """`<task>/<kind>/<number>` in the template library."""
    template_split: TemplateSplit = "seen"
    """Whether training may see the sentence."""
    components: dict[str, str]
    """Placeholder to the words that fill it."""
    pairs: tuple[Pair, ...]
    """Every (object, place) that satisfies the sentence, sorted."""


class SeedKey(Strict):
    """Address of the generator that drew the scene; see `codediffuser.seeding`."""

    root: int
    stage: str
    index: int
    attempt: int


def _upgrade_1_to_2(raw: Raw) -> Raw:
    """Version 1 said `train` of every scene, and had neither template splits nor labels."""
    return {**raw, "split": "all" if raw.get("split") == "train" else raw.get("split", "all")}


class SceneSpec(Document):
    """One initial configuration (`schema: codediffuser.scene/2`)."""

    KIND: ClassVar[str] = "scene"
    VERSION: ClassVar[int] = 2
    UPGRADES: ClassVar[dict[int, Callable[[Raw], Raw]]] = {1: _upgrade_1_to_2}

    task: str
    variant: str = "sim"
    scene_id: str
    """Six digits; names the files of the scene and of its episode."""
    seed: SeedKey
    split: Split = "all"
    objects: tuple[ObjectSpec, ...]
    places: tuple[PlaceSpec, ...]
    target: Target
    ambiguity: Ambiguity
    instruction: InstructionSpec

    @model_validator(mode="after")
    def _ids_fit_together(self) -> Self:
        for kind, ids in (
            ("object", [o.id for o in self.objects]),
            ("place", [p.id for p in self.places]),
        ):
            twice = [name for name, count in Counter(ids).items() if count > 1]
            if twice:
                raise ValueError(f"{kind} ids are used twice: {', '.join(twice)}")
        objects = {o.id for o in self.objects}
        places = {p.id for p in self.places}
        named = [("target", self.target.pick, self.target.place)]
        named += [("instruction pair", *pair) for pair in self.instruction.pairs]
        for what, pick, place in named:
            if pick not in objects or place not in places:
                raise ValueError(f"{what} ({pick}, {place}) names no object or no place")
        for taken in (o.place for o in self.objects):
            if taken is not None and taken not in places:
                raise ValueError(f"an object takes the place '{taken}', which does not exist")
        return self

    def object(self, object_id: str) -> ObjectSpec:
        """The object with this id; `KeyError` when there is none."""
        return {o.id: o for o in self.objects}[object_id]

    def place(self, place_id: str) -> PlaceSpec:
        """The place with this id; `KeyError` when there is none."""
        return {p.id: p for p in self.places}[place_id]

    @property
    def pickable(self) -> tuple[ObjectSpec, ...]:
        """Objects that move and take no place yet."""
        return pickable_objects(self.objects)

    @property
    def free_places(self) -> tuple[PlaceSpec, ...]:
        """Places that no object takes."""
        return untaken_places(self.objects, self.places)


def pickable_objects(objects: tuple[ObjectSpec, ...]) -> tuple[ObjectSpec, ...]:
    """Objects that move and take no place yet, in their order."""
    return tuple(o for o in objects if not o.fixed and o.place is None)


def untaken_places(
    objects: tuple[ObjectSpec, ...], places: tuple[PlaceSpec, ...]
) -> tuple[PlaceSpec, ...]:
    """Places that no object takes, in their order."""
    taken = {o.place for o in objects}
    return tuple(p for p in places if p.id not in taken)


def scene_path(run: Path, scene_id: str) -> Path:
    """File of a scene in its run."""
    return run / SCENES / f"{scene_id}.yaml"
