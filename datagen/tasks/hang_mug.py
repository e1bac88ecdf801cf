"""Pick a mug from the table and hang it by its handle on one branch of a mug tree.

Randomised: where the mugs stand, their colours and shapes, how far their handles are turned.
Success: the mug hangs below a branch that the instruction allows, with its handle around that
branch and no other, off the table, released and at rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import model_validator

from codediffuser.datagen import drawing
from codediffuser.datagen.instructions.components import Component, PlaceByDistance, extremes
from codediffuser.datagen.instructions.mug_components import BranchAt, MugCalled
from codediffuser.datagen.layout import Layout, LayoutRequest, fixed_count
from codediffuser.datagen.mug_check import SuccessConfig, check_hung, hanging_failure
from codediffuser.datagen.mug_hanging import HangingConfig, hang_mug_moves
from codediffuser.datagen.mug_meshes import mug_geometry
from codediffuser.datagen.mug_shapes import (
    MugConfig,
    MugShape,
    draw_mug_shape,
    mug_from_above,
)
from codediffuser.datagen.mug_tree import (
    TREE,
    TreeConfig,
    spoken,
    tree_branches,
    tree_from_above,
    tree_geometry,
    tree_object,
    tree_of,
    tree_places,
)
from codediffuser.datagen.ranges import Range
from codediffuser.datagen.scene import ObjectSpec, Pair, SceneSpec
from codediffuser.datagen.task import TASKS, Check, Geometry, Move, Pad, SceneView, Task
from codediffuser.datagen.task_config import TaskConfig
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import PlacementError
from codediffuser.poses import matrix_to_quat_wxyz, rotation_z
from codediffuser.registry import unknown_name
from codediffuser.schema import Strict

LABEL_WIDTH_M = 0.09
"""Room for the names of branches beside the tree, in reset pictures."""


class AreaConfig(Strict):
    """A rectangle of the table that one mug stands in."""

    x_m: Range
    y_m: Range


class VariantConfig(Strict):
    """Ranges that scenes are drawn from, and the tree that stands there."""

    colors: tuple[str, ...]
    """Of `mug.colors`; no two mugs of a scene share one."""
    areas: tuple[AreaConfig, ...]
    """As many as there are mugs; which mug stands in which is drawn."""
    min_distance_m: float
    """Between the axes of two mugs."""
    max_tries: int
    handle_yaw_rad: float
    """Handles point away from the observer, turned by up to this much."""
    tree: TreeConfig

    @model_validator(mode="after")
    def _enough_colors(self) -> Self:
        if not 1 <= len(self.areas) <= len(set(self.colors)):
            raise ValueError(
                f"expected at least one area and as many colors, got {len(self.areas)} areas and "
                f"{len(set(self.colors))} colors"
            )
        return self


class LanguageConfig(Strict):
    """How far apart things must be for words to tell them apart."""

    mug_margin_m: float
    """Between an extreme mug ("left-most") and the next one, along the direction."""
    branch_margin_m: float
    """Between a branch's height and the highest, or its side and the middle, to count as such."""
    branch_distance_margin_m: float
    """Between the distances of the nearest (furthest) branch and of the next one."""


class HangMugConfig(TaskConfig[VariantConfig]):
    """Everything in `hang_mug.yaml`."""

    mug: MugConfig
    language: LanguageConfig
    success: SuccessConfig
    script: HangingConfig

    @model_validator(mode="after")
    def _colors_are_known(self) -> Self:
        for name, variant in self.variants.items():
            for color in variant.colors:
                if color not in self.mug.colors:
                    raise ValueError(
                        f"variants.{name}.colors: "
                        f"{unknown_name('color', color, sorted(self.mug.colors))}"
                    )
        return self


@TASKS.add("hang_mug")
class HangMug(Task[HangMugConfig, VariantConfig]):
    """Hang one of the mugs on one branch."""

    name: ClassVar[str] = "hang_mug"
    config_type: ClassVar[type[TaskConfig]] = HangMugConfig
    pick_category: ClassVar[str] = "mug"
    place_category: ClassVar[str] = "branch"

    def arrange(self, rng: np.random.Generator, asked: LayoutRequest[VariantConfig]) -> Layout:
        """Mugs of different colours, clear of each other, before an empty tree."""
        ranges = asked.ranges
        branches = tree_places(ranges.tree)
        fixed_count("picks: mugs", asked.picks, len(ranges.areas))
        fixed_count("places: branches", asked.places, len(branches))
        spots = self._spots(rng, ranges, asked.key)
        colors = [ranges.colors[i] for i in rng.permutation(len(ranges.colors))[: len(spots)]]
        mugs = [
            self._mug(rng, f"mug_{i}", color, xy, ranges.handle_yaw_rad)
            for i, (color, xy) in enumerate(zip(colors, spots, strict=True))
        ]
        return Layout((*mugs, tree_object(ranges.tree)), branches)

    @staticmethod
    def _spots(rng: np.random.Generator, ranges: VariantConfig, keys: str) -> np.ndarray:
        """Positions (mugs, 2) m, each in an area of its own, in drawn order."""
        areas = [ranges.areas[i] for i in rng.permutation(len(ranges.areas))]
        low, high = (np.array([(a.x_m[end], a.y_m[end]) for a in areas]) for end in (0, 1))
        for _ in range(ranges.max_tries):
            spots = rng.uniform(low, high)
            gaps = np.linalg.norm(spots[:, None] - spots[None], axis=-1)
            if np.all(gaps[np.triu_indices(len(spots), 1)] >= ranges.min_distance_m):
                return np.asarray(spots)
        raise PlacementError(
            f"cannot place {len(areas)} mugs at least {ranges.min_distance_m:g} m apart in "
            f"{ranges.max_tries} tries; lower '{keys}.min_distance_m', or move '{keys}.areas' apart"
        )

    def _mug(
        self, rng: np.random.Generator, mug_id: str, color: str, xy_m: np.ndarray, turn_rad: float
    ) -> ObjectSpec:
        shape = draw_mug_shape(rng, self.config.mug)
        back = np.arctan2(self.config.observer.back[1], self.config.observer.back[0])
        yaw = float(back + rng.uniform(-turn_rad, turn_rad))
        w, x, y, z = matrix_to_quat_wxyz(rotation_z(yaw))
        return ObjectSpec(
            id=mug_id, category="mug", name=f"{color} mug",
            position_m=(float(xy_m[0]), float(xy_m[1]), shape.height_m / 2),
            quat_wxyz=(float(w), float(x), float(y), float(z)),
            color_rgb=self.config.mug.colors[color], shape=shape.sizes(),
        )  # fmt: skip

    def phrases(self) -> Iterable[Component]:
        """Mugs by colour and by where they stand; branches by side, level and distance."""
        side, margins = self.config.observer, self.config.language
        margin = margins.branch_margin_m
        yield from extremes("mug", side.extremes, margins.mug_margin_m)
        for color in self.config.mug.colors:
            yield MugCalled(f"{color} mug", "mug")
        apart = margins.branch_distance_margin_m
        yield PlaceByDistance("furthest branch", "branch", "furthest", apart)
        yield PlaceByDistance("nearest branch", "branch", "nearest", apart)
        yield BranchAt("right-topmost branch", "branch", side.right, "top", margin)
        yield BranchAt("left-topmost branch", "branch", side.left, "top", margin)
        yield BranchAt("right-middle branch", "branch", side.right, "middle", margin)
        yield BranchAt("left-middle branch", "branch", side.left, "middle", margin)
        yield BranchAt("right branch", "branch", side.right, None, margin)
        yield BranchAt("left branch", "branch", side.left, None, margin)
        yield BranchAt("top branch", "branch", None, "top", margin)

    def pads(self, variant: str) -> tuple[Pad, ...]:
        """One pad, a margin larger than the areas of the mugs' middles together."""
        ranges, picture = self.ranges(variant), self.config.reset_image
        margin = picture.pad_margin_m
        low = np.min([(a.x_m[0], a.y_m[0]) for a in ranges.areas], axis=0) - margin
        high = np.max([(a.x_m[1], a.y_m[1]) for a in ranges.areas], axis=0) + margin
        corners = ((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
        return (Pad("pad", *corners, picture.cross_spacing_m),)

    def draw_reset(self, scene: SceneSpec) -> drawing.Drawing:
        """Tree and pad from above; the target mug carries the name of its branch."""
        (pad,) = self.pads(scene.variant)
        tree = self.ranges(scene.variant).tree
        place = scene.target.place
        painted = [*tree_from_above(tree, place), *drawing.pad_with_crosses(pad)]
        for mug in (o for o in scene.objects if o.category == "mug"):
            words = spoken(place) if mug.id == scene.target.pick else None
            painted += mug_from_above(mug, words)
        reach = max(branch.length_m for branch in tree.branches.values())
        across = reach + LABEL_WIDTH_M
        x, y, _ = tree.position_m
        return drawing.reset_drawing(
            scene, painted, self.config.observer,
            low_m=(min(pad.low_m[0], x - across), min(pad.low_m[1], y - reach)),
            high_m=(max(pad.high_m[0], x + across), max(pad.high_m[1], y + reach)),
            notes=(f"{scene.ambiguity.picks} mugs", f"{scene.ambiguity.places} branches"),
        )  # fmt: skip

    def geometry(self, obj: ObjectSpec) -> Geometry:
        """The tree as it stands in the scene, or a mug of the shape that is stored with it."""
        if obj.category == TREE:
            return tree_geometry(obj)
        return mug_geometry(MugShape.of(obj.shape), self.config.mug)

    def script(self, view: SceneView, rng: np.random.Generator) -> Iterator[Move]:
        """Take the target mug by its sides and lead its handle over the target branch."""
        target, tree = view.scene.target, tree_of(view.scene)
        yield from hang_mug_moves(
            view, rng, self.config.script,
            pick=target.pick,
            shape=MugShape.of(view.scene.object(target.pick).shape),
            branch=tree_branches(tree)[target.place],
            branch_radius_m=tree.shape["branch_radius_m"],
        )  # fmt: skip

    def check_success(self, view: SceneView, pairs: Sequence[Pair]) -> Check:
        """The supplement's two criteria, and also: around the branch, let go, hanging still."""
        hang_m = self.ranges(view.scene.variant).tree.hang_m
        return check_hung(self.config.success, hang_m, view, pairs)

    def failure_phase(self, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]) -> str:
        """Phase and what happened in it: `grasp:missed`, `insert:missed_branch`, ..."""
        return hanging_failure(self.config.success, scene, trajectory, pairs)
