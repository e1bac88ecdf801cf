"""Pictures of recorded states: right shapes, repeatable, and loud when a camera is useless."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.datagen.views import Moment, moment_at
from codediffuser.errors import RenderError

rendering = pytest.importorskip("codediffuser.datagen.rendering")
pytestmark = pytest.mark.sim

if TYPE_CHECKING:
    from codediffuser.datagen.rendering import Frame, Renderer
    from codediffuser.datagen.script import ExpertRun


@pytest.fixture
def start(expert_run: ExpertRun) -> Moment:
    return moment_at(expert_run.trajectory, 0)


def at_reset(scene: SceneSpec, like: Moment) -> Moment:
    """The state in which a scene starts, with the robot as in `like`."""
    movable = [o for o in scene.objects if not o.fixed]
    return Moment(
        object_position_m=np.array([o.position_m for o in movable]),
        object_quat_wxyz=np.array([o.quat_wxyz for o in movable]),
        object_velocity=np.zeros((len(movable), 6)),
        qpos=like.qpos, qvel=like.qvel,
        hand_position_m=like.hand_position_m, hand_quat_wxyz=like.hand_quat_wxyz,
    )  # fmt: skip


def same(a: dict[str, Frame], b: dict[str, Frame]) -> bool:
    return all(
        np.array_equal(a[n].rgb, b[n].rgb)
        and np.array_equal(a[n].depth_m, b[n].depth_m)
        and np.array_equal(a[n].object_index, b[n].object_index)
        for n in a
    )


def sapiens_own(renderer: Renderer, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour, depth in mm and entity of one camera by SAPIEN's shader `minimal`."""
    sapien = pytest.importorskip("sapien")
    for picture in ("Color", "ColorRaw"):
        sapien.render.set_picture_format(picture, "r8g8b8a8unorm")
    sapien.render.set_picture_format("PositionSegmentation", "r16g16b16a16sint")
    shaders = Path(sapien.__file__).parent / "vulkan_shader" / "minimal"
    ours, config = renderer._components[name], renderer.cameras
    camera = sapien.render.RenderCameraComponent(config.width, config.height, str(shaders))
    camera.set_fovy(config.fov_y_rad, compute_x=True)
    camera.near, camera.far = config.near_m, config.far_m
    entity = sapien.Entity()
    entity.add_component(camera)
    entity.set_pose(ours.entity.pose)
    renderer._scene.add_entity(entity)
    renderer._scene.update_render()
    camera.take_picture()
    color, position = camera.get_picture("Color"), camera.get_picture("PositionSegmentation")
    renderer._scene.remove_entity(entity)
    return color[..., :3].astype(int), -position[..., 2], position[..., 3]


def test_pictures_are_those_of_sapiens_own_shader(
    small_renderer: Renderer, expert_run: ExpertRun, start: Moment
) -> None:
    small_renderer.set_scene(expert_run.scene)
    for name, frame in small_renderer.render(start).items():
        color, depth_mm, entity = sapiens_own(small_renderer, name)
        difference = np.abs(color - frame.rgb)
        assert difference.max() <= 1 and (difference > 0).mean() < 1e-3
        assert (np.rint(frame.depth_m * 1000) == depth_mm).mean() > 0.9999
        np.testing.assert_array_equal(frame.object_index, small_renderer._object_index[entity])


def test_frames_have_the_promised_shapes_and_types(
    small_renderer: Renderer, expert_run: ExpertRun, start: Moment
) -> None:
    small_renderer.set_scene(expert_run.scene)
    frames = small_renderer.render(start)
    assert list(frames) == [v.name for v in small_renderer.cameras.views]
    for frame in frames.values():
        assert frame.rgb.shape == (120, 160, 3) and frame.rgb.dtype == np.uint8
        assert frame.depth_m.shape == (120, 160) and frame.depth_m.dtype == np.float32
        assert frame.object_index.shape == (120, 160)
        assert frame.rgb.flags.c_contiguous and frame.rgb.std() > 10
        assert np.isfinite(frame.depth_m).all() and frame.depth_m.min() >= 0


def test_nothing_is_hit_where_depth_is_zero(
    small_renderer: Renderer, expert_run: ExpertRun, start: Moment
) -> None:
    small_renderer.set_scene(expert_run.scene)
    for frame in small_renderer.render(start).values():
        missing = frame.depth_m == 0
        assert (frame.object_index[missing] == rendering.NOTHING_ID).all()


def test_each_object_and_the_robot_are_seen_under_their_own_number(
    small_renderer: Renderer, expert_run: ExpertRun, start: Moment
) -> None:
    small_renderer.set_scene(expert_run.scene)
    frames = small_renderer.render(start)
    seen = set(np.concatenate([np.unique(f.object_index) for f in frames.values()]).tolist())
    rows = set(range(len(expert_run.scene.objects)))
    assert seen == rows | {rendering.ROBOT_ID, rendering.NOTHING_ID}


def test_objects_are_drawn_in_their_colors(
    small_renderer: Renderer, expert_run: ExpertRun, start: Moment
) -> None:
    small_renderer.set_scene(expert_run.scene)
    frames = small_renderer.render(start)
    for row, obj in enumerate(expert_run.scene.objects):
        pixels = np.concatenate([f.rgb[f.object_index == row] for f in frames.values()])
        drawn = np.median(pixels, axis=0)
        if np.ptp(obj.color_rgb) > 0.1:
            assert np.argmax(drawn) == np.argmax(obj.color_rgb), obj.name


def test_same_state_gives_the_same_pictures_whatever_was_drawn_before(
    small_renderer: Renderer, scenes: list[SceneSpec], start: Moment
) -> None:
    first, second = scenes[0], scenes[1]
    small_renderer.set_scene(first)
    before = small_renderer.render(at_reset(first, start))
    small_renderer.set_scene(second)
    other = small_renderer.render(at_reset(second, start))
    small_renderer.set_scene(first)
    assert same(before, small_renderer.render(at_reset(first, start)))
    assert not same(before, other)


def test_pictures_follow_the_state(
    small_renderer: Renderer, expert_run: ExpertRun, start: Moment
) -> None:
    small_renderer.set_scene(expert_run.scene)
    row = [o.id for o in expert_run.scene.objects].index(expert_run.scene.target.pick)
    end = moment_at(expert_run.trajectory, -1)
    views = [small_renderer.render(m)["right_bottom"].object_index == row for m in (start, end)]
    centers = [np.argwhere(v).mean(axis=0) for v in views]
    assert np.linalg.norm(centers[0] - centers[1]) > 10


def test_robot_in_the_picture_stands_where_physics_had_it(
    small_renderer: Renderer, expert_run: ExpertRun
) -> None:
    moment = moment_at(expert_run.trajectory, 100)
    small_renderer.set_scene(expert_run.scene)
    small_renderer.render(moment)
    hand = small_renderer._robot.find_link_by_name("panda_hand").entity.pose
    np.testing.assert_allclose(hand.p, moment.hand_position_m, atol=1e-5)


def test_exchanging_scenes_leaves_nothing_behind(
    small_renderer: Renderer, scenes: list[SceneSpec]
) -> None:
    small_renderer.set_scene(scenes[0])
    count = len(small_renderer._scene.entities)
    for scene in [*scenes[1:6], scenes[0]]:
        small_renderer.set_scene(scene)
    assert len(small_renderer._scene.entities) == count


def test_moment_of_another_scene_is_refused(
    small_renderer: Renderer, scenes: list[SceneSpec], start: Moment
) -> None:
    other = next(s for s in scenes if len(s.objects) != len(scenes[0].objects))
    small_renderer.set_scene(scenes[0])
    with pytest.raises(RenderError, match="set the scene it was recorded in"):
        small_renderer.render(at_reset(other, start))


def test_camera_that_looks_away_is_named(
    pack_battery: PackBattery, scenes: list[SceneSpec], start: Moment
) -> None:
    cameras = pack_battery.config.cameras
    away = cameras.views[1].model_copy(update={"look": (0.0, 0.0, 1.0)})
    blind = cameras.model_copy(
        update={"views": (cameras.views[0], away), "width": 64, "height": 48}
    )
    renderer = rendering.Renderer(pack_battery, blind)
    renderer.set_scene(scenes[0])
    with pytest.raises(RenderError, match=r"camera 'right_bottom'.*sees nothing of the workspace"):
        renderer.render(at_reset(scenes[0], start))


def test_render_before_a_scene_is_set_says_so(pack_battery: PackBattery, start: Moment) -> None:
    cameras = pack_battery.config.cameras.model_copy(update={"width": 32, "height": 24})
    with pytest.raises(RenderError, match="call set_scene before render"):
        rendering.Renderer(pack_battery, cameras).render(start)
