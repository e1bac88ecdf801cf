"""A mug tree: trunk, base and rising branches; where its places are, and how one speaks of them.

Everything about a tree that is in a scene can be read from its `ObjectSpec` alone.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from pydantic import model_validator

from codediffuser.datagen import drawing
from codediffuser.datagen.scene import ObjectSpec, PlaceSpec, SceneSpec, Vector3
from codediffuser.datagen.shapes import join
from codediffuser.datagen.task import Geometry
from codediffuser.schema import Strict

if TYPE_CHECKING:
    import trimesh

TREE = "mug tree"
"""Category of the tree."""

TREE_FRICTION = 0.5
WOOD: drawing.Color = "#c79a63"
WOOD_LIGHT: drawing.Color = "#efe3d0"
WOOD_DARK: drawing.Color = "#8a6237"
LABEL_GAP_M = 0.012
"""Between the tip of a branch and its name, in reset pictures."""
_AZIMUTH, _HEIGHT, _RISE, _LENGTH = "_azimuth_rad", "_height_m", "_rise_rad", "_length_m"


class BranchConfig(Strict):
    """One branch; its axis starts on the trunk's."""

    azimuth_rad: float
    """Direction seen from above: 0 is +x, pi/2 is +y."""
    height_m: float
    """Of the start of its axis above the tree's foot."""
    rise_rad: float
    """How steeply it rises."""
    length_m: float
    """From the trunk's axis to the tip."""
    used: bool = True
    """Whether mugs are hung on it."""


class TreeConfig(Strict):
    """A mug tree."""

    position_m: Vector3
    """Middle of its foot."""
    color_rgb: Vector3
    trunk_radius_m: float
    trunk_height_m: float
    foot_radius_m: float
    foot_height_m: float
    branch_radius_m: float
    hang_m: float
    """Where along a branch mugs are hung, from the trunk's axis."""
    hang_drop_m: float
    """How far the middle of a hanging mug lies below that point, roughly."""
    branches: dict[str, BranchConfig]
    """Name (`right_topmost`) to branch; the name is also the id of the place."""

    @model_validator(mode="after")
    def _mugs_hang_on_branches(self) -> Self:
        for name, branch in self.branches.items():
            if not self.trunk_radius_m < self.hang_m < branch.length_m:
                raise ValueError(
                    f"hang_m: expected more than trunk_radius_m ({self.trunk_radius_m:g}) and less "
                    f"than branches.{name}.length_m ({branch.length_m:g}), got {self.hang_m:g}"
                )
        return self


@dataclass(frozen=True, slots=True)
class Branch:
    """A branch in the world."""

    start_world: np.ndarray
    """(3,) where its axis leaves the trunk's, m."""
    direction: np.ndarray
    """(3,) unit vector toward its tip."""
    length_m: float

    def at(self, along_m: float) -> np.ndarray:
        """Point (3,) of the axis; beyond the length it lies in the air before the tip."""
        return np.asarray(self.start_world + along_m * self.direction)


def tree_object(tree: TreeConfig) -> ObjectSpec:
    """The tree itself, which does not move."""
    sizes = {
        "trunk_radius_m": tree.trunk_radius_m,
        "trunk_height_m": tree.trunk_height_m,
        "foot_radius_m": tree.foot_radius_m,
        "foot_height_m": tree.foot_height_m,
        "branch_radius_m": tree.branch_radius_m,
    }
    for name, branch in tree.branches.items():
        sizes[name + _AZIMUTH] = branch.azimuth_rad
        sizes[name + _HEIGHT] = branch.height_m
        sizes[name + _RISE] = branch.rise_rad
        sizes[name + _LENGTH] = branch.length_m
    return ObjectSpec(
        id="mug_tree",
        category=TREE,
        name=TREE,
        position_m=tree.position_m,
        color_rgb=tree.color_rgb,
        fixed=True,
        shape=sizes,
    )


def tree_of(scene: SceneSpec) -> ObjectSpec:
    """The tree of a scene."""
    return next(o for o in scene.objects if o.category == TREE)


def tree_branches(tree: ObjectSpec) -> dict[str, Branch]:
    """All branches of a scene's tree by name, also those that are not used."""
    names = [key.removesuffix(_AZIMUTH) for key in tree.shape if key.endswith(_AZIMUTH)]
    branches = {}
    for name in names:
        azimuth, rise = tree.shape[name + _AZIMUTH], tree.shape[name + _RISE]
        flat = np.cos(rise)
        branches[name] = Branch(
            np.add(tree.position_m, (0.0, 0.0, tree.shape[name + _HEIGHT])),
            np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(rise)]),
            tree.shape[name + _LENGTH],
        )
    return branches


def tree_places(tree: TreeConfig) -> tuple[PlaceSpec, ...]:
    """A place for every branch that is used; its region is a box around the branch alone."""
    branches = tree_branches(tree_object(tree))
    return tuple(
        _place(name, branches[name], tree) for name, config in tree.branches.items() if config.used
    )


def _place(name: str, branch: Branch, tree: TreeConfig) -> PlaceSpec:
    # The box begins so far out that none of its corners reaches into the trunk.
    flat = float(np.linalg.norm(branch.direction[:2]))
    begin = branch.at((tree.trunk_radius_m + 1.5 * tree.branch_radius_m) / flat)
    tip = branch.at(branch.length_m)
    low = np.minimum(begin, tip) - tree.branch_radius_m
    high = np.maximum(begin, tip) + tree.branch_radius_m
    return PlaceSpec(
        id=name,
        category="branch",
        position_m=_vector(branch.at(tree.hang_m) - np.array([0.0, 0.0, tree.hang_drop_m])),
        size_m=_vector(high - low),
        center_m=_vector((low + high) / 2),
    )


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = np.round(values, 6)
    return (float(x), float(y), float(z))


def tree_from_above(tree: TreeConfig, target: str | None = None) -> list[drawing.Shape]:
    """The tree in a reset picture, every branch under its name, the target in green."""
    x, y, _ = tree.position_m
    painted: list[drawing.Shape] = [drawing.Disc((x, y), tree.foot_radius_m, WOOD_LIGHT, WOOD_DARK)]
    for name, branch in tree_branches(tree_object(tree)).items():
        used, is_target = tree.branches[name].used, name == target
        fill = drawing.TARGET if is_target else WOOD if used else WOOD_LIGHT
        edge = drawing.TARGET_EDGE if is_target else WOOD_DARK
        painted.append(drawing.Polygon(_from_above(branch, tree.branch_radius_m), fill, edge))
        ink = drawing.TARGET_EDGE if is_target else drawing.INK if used else drawing.FAINT
        label_x, label_y = branch.at(branch.length_m)[:2] + LABEL_GAP_M * branch.direction[:2]
        words = spoken(name) if used else f"{spoken(name)} (not used)"
        align: Literal["left", "center", "right"] = "center"
        if abs(branch.direction[0]) > 0.5:
            align = "left" if branch.direction[0] > 0 else "right"
        at = (float(label_x), float(label_y))
        painted.append(drawing.Text(at, words, 9, ink, bold=is_target, align=align))
    painted.append(drawing.Disc((x, y), tree.trunk_radius_m, WOOD_DARK, WOOD_DARK))
    return painted


def _from_above(branch: Branch, radius_m: float) -> tuple[drawing.Point, ...]:
    """Outline of a branch on the table: four corners."""
    start, tip = branch.at(0.0)[:2], branch.at(branch.length_m)[:2]
    along = branch.direction[:2] / np.linalg.norm(branch.direction[:2])
    side = radius_m * np.array([-along[1], along[0]])
    corners = (start + side, tip + side, tip - side, start - side)
    return tuple((float(x), float(y)) for x, y in corners)


def spoken(name: str) -> str:
    """The name of a branch in words: `right_topmost` -> `right-topmost`."""
    return name.replace("_", "-")


def tree_geometry(tree: ObjectSpec) -> Geometry:
    """Foot, trunk and branches, each an exact convex part."""
    parts = _parts(tuple(sorted(tree.shape.items())))
    return Geometry(
        visual=join(list(parts)),
        collision=parts,
        static_friction=TREE_FRICTION,
        dynamic_friction=TREE_FRICTION,
        restitution=0.0,
    )


@functools.lru_cache(maxsize=8)
def _parts(sizes: tuple[tuple[str, float], ...]) -> tuple[trimesh.Trimesh, ...]:
    """Parts in the tree's own frame, whose origin is the middle of its foot."""
    import trimesh

    shape = dict(sizes)
    tree = ObjectSpec(
        id="mug_tree", category=TREE, name=TREE, position_m=(0.0, 0.0, 0.0),
        color_rgb=(0.0, 0.0, 0.0), shape=shape,
    )  # fmt: skip
    foot, trunk = shape["foot_height_m"], shape["trunk_height_m"]
    columns = [
        ((0.0, 0.0, 0.0), (0.0, 0.0, foot), shape["foot_radius_m"], 32),
        ((0.0, 0.0, foot), (0.0, 0.0, trunk), shape["trunk_radius_m"], 16),
    ]
    columns += [
        (tuple(b.start_world), tuple(b.at(b.length_m)), shape["branch_radius_m"], 16)
        for b in tree_branches(tree).values()
    ]
    return tuple(
        trimesh.creation.cylinder(radius=radius, segment=np.array([start, end]), sections=sections)
        for start, end, radius, sections in columns
    )
