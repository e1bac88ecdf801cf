from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from codediffuser.datagen.bookshelf import ShelfConfig
from codediffuser.datagen.box_row import BoxRow
from codediffuser.datagen.episode_format import Camera
from codediffuser.datagen.task import Task, get_task
from codediffuser.datagen.task_config import ClusterConfig, LabelingConfig, Workspace
from codediffuser.errors import ConfigError
from codediffuser.labeling.perception.builtin import Perceived
from codediffuser.labeling.perception.finding import find_instances
from codediffuser.labeling.perception.references import ReferenceLibrary, make_reference
from codediffuser.labeling.perception.views import View
from codediffuser.pointcloud import backproject_depth

MakeViews = Callable[..., tuple[View, ...]]
TOP_M = 0.08
"""Of the box in the made views."""


class ByColor:
    """Features that are the picture's colours."""

    name = "color"
    dimensions = 3

    def maps(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None = None,
        cameras: Sequence[Camera] | None = None,
    ) -> np.ndarray:
        return images.astype(np.float32) / 255


class TwoHalves(ByColor):
    """Also tells that the box is two things that touch at x = 0."""

    def perceive(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None,
        cameras: Sequence[Camera] | None,
    ) -> Perceived:
        assert depth_m is not None
        assert cameras is not None
        middles = np.zeros((*depth_m.shape, 3), np.float32)
        for depth, camera, out in zip(depth_m, cameras, middles, strict=True):
            points, pixel = backproject_depth(depth, camera.K, camera.T_world_camera)
            side = np.where(points[:, 0] > 0, 0.025, -0.025)
            out.reshape(-1, 3)[pixel, 0] = side
        return Perceived(self.maps(images), middles)


def library(**colors: tuple[float, float, float]) -> ReferenceLibrary:
    picture = np.zeros((1, 1, 3), np.uint8)
    return ReferenceLibrary(
        backend="color",
        dimensions=3,
        threshold=0.9,
        references=tuple(
            make_reference(
                np.array(color), picture, name, episode="", frame=0, camera="", pixel=(0, 0),
                by="test", at="",
            )
            for name, color in colors.items()
        ),
    )  # fmt: skip


RED_AND_GREEN = {"mug": (1.0, 0, 0), "background": (0, 1.0, 0)}


@pytest.fixture(scope="module")
def task() -> Task:
    found = get_task("hang_mug")
    sizes = ClusterConfig(eps_m=0.015, vote_reach_m=0.015)
    found.config = found.config.model_copy(
        update={
            "workspace": Workspace(low_m=(-0.2, -0.2, 0.003), high_m=(0.2, 0.2, 0.3)),
            "labeling": LabelingConfig(clusters={"mug": sizes, "branch": sizes}),
        }
    )
    return found


def test_points_of_a_category_without_votes_are_clustered(
    make_views: MakeViews, task: Task
) -> None:
    (box,) = find_instances(make_views(), task, ByColor(), library(**RED_AND_GREEN))
    assert box.category == "mug"
    assert box.points_world[:, 2].max() == pytest.approx(TOP_M, abs=1e-3)
    assert set(map(tuple, box.rgb)) == {(200, 0, 0)}


def test_votes_part_what_touches(make_views: MakeViews, task: Task) -> None:
    left, right = find_instances(make_views(), task, TwoHalves(), library(**RED_AND_GREEN))
    assert left.points_world[:, 0].max() <= 0 <= right.points_world[:, 0].min()
    np.testing.assert_allclose(left.middle_world, [-0.025, 0, 0], atol=1e-6)


@pytest.mark.parametrize(("thickness_m", "count"), [((0.09, 0.11), 1), ((0.045, 0.055), 2)])
def test_pieces_that_are_one_box_of_a_row_are_one_instance(
    make_views: MakeViews, task: Task, thickness_m: tuple[float, float], count: int
) -> None:
    # The box is 0.1 m wide, and votes part it in the middle.
    shelf = ShelfConfig(
        spine_y_m=-0.04, floor_m=0.0, lip_m=0.02, back_gap_m=0.001, wall_m=0.01, height_m=0.12,
        color_rgb=(0.4, 0.3, 0.2),
    )  # fmt: skip
    in_row = get_task("hang_mug")
    in_row.config, in_row.row = task.config, BoxRow(shelf, 0.08, thickness_m)
    found = find_instances(make_views(), in_row, TwoHalves(), library(**RED_AND_GREEN))
    assert [f.category for f in found] == ["mug"] * count
    (whole,) = find_instances(make_views(), task, ByColor(), library(**RED_AND_GREEN))
    assert sum(len(f.points_world) for f in found) > 0.9 * len(whole.points_world)


def test_an_absent_category_gives_nothing(make_views: MakeViews, task: Task) -> None:
    blue = {"mug": (0, 0, 1.0), "background": (0, 1.0, 0)}
    assert find_instances(make_views(), task, ByColor(), library(**blue)) == ()
    # A category without any reference is absent too.
    assert find_instances(make_views(), task, ByColor(), library(), ["branch"]) == ()


def test_a_category_of_unknown_size_is_refused(make_views: MakeViews, task: Task) -> None:
    with pytest.raises(ConfigError, match="labeling: clusters: spoon"):
        find_instances(make_views(), task, ByColor(), library(), ["spoon"])
