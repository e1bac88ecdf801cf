"""Camera axes: laws without a simulator, and agreement with what the renderer draws."""

from __future__ import annotations

import numpy as np
import pytest

from codediffuser.datagen.cameras import (
    T_world_camera,
    camera_parameters,
    intrinsics,
    project,
    sapien_camera_pose,
)
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task_config import CameraConfig, CameraView
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.datagen.views import moment_at
from codediffuser.pointcloud import backproject_depth
from codediffuser.poses import apply_transform


def test_what_a_camera_looks_at_falls_on_the_principal_point(pack_battery: PackBattery) -> None:
    config = pack_battery.config.cameras
    for view in config.views:
        K, T = camera_parameters(config)[view.name]
        ahead = np.array(view.position_m) + 0.7 * np.array(view.look) / np.linalg.norm(view.look)
        uv, depth_m = project(ahead[None], K, T)
        np.testing.assert_allclose(uv[0], K[:2, 2], atol=1e-9)
        np.testing.assert_allclose(depth_m, 0.7)


def test_right_in_the_world_is_right_in_the_picture_and_up_is_up() -> None:
    view = CameraView(name="front", position_m=(0, -1, 0.5), look=(0, 1, 0), right=(1, 0, 0))
    config = CameraConfig(views=(view,))
    K, T = camera_parameters(config)["front"]
    (right, up), _ = project(np.array([[0.1, 0, 0.5], [0, 0, 0.6]]), K, T)
    assert right[0] > K[0, 2] and right[1] == pytest.approx(K[1, 2])
    assert up[1] < K[1, 2] and up[0] == pytest.approx(K[0, 2])


def test_field_of_view_spans_the_picture_and_pixels_are_square() -> None:
    config = CameraConfig(width=320, height=240, fov_y_rad=0.9, views=())
    K = intrinsics(config)
    assert K[0, 0] == K[1, 1]
    # From the upper edge of row 0 to the lower edge of row 239.
    angles = np.arctan((np.array([-0.5, 239.5]) - K[1, 2]) / K[1, 1])
    assert angles[1] - angles[0] == pytest.approx(0.9)


def test_projection_undoes_back_projection(pack_battery: PackBattery) -> None:
    K, T = camera_parameters(pack_battery.config.cameras)["left_top"]
    depth_m = np.random.default_rng(0).uniform(0.3, 1.5, (240, 320)).astype(np.float32)
    points, pixel = backproject_depth(depth_m, K, T)
    uv, back_m = project(points, K, T)
    v, u = np.divmod(pixel, 320)
    np.testing.assert_allclose(uv, np.column_stack([u, v]), atol=1e-2)
    np.testing.assert_allclose(back_m, depth_m[v, u], atol=1e-5)


def test_simulator_pose_points_its_x_axis_along_the_look(pack_battery: PackBattery) -> None:
    for view in pack_battery.config.cameras.views:
        pose = sapien_camera_pose(T_world_camera(view)).to_transformation_matrix()
        look = np.array(view.look) / np.linalg.norm(view.look)
        np.testing.assert_allclose(pose[:3, 0], look, atol=1e-6)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.sim
def test_renderer_uses_the_stated_intrinsics(small_renderer) -> None:  # type: ignore[no-untyped-def]
    for name, (K, _) in small_renderer.parameters.items():
        component = small_renderer._components[name]
        assert component.fx == pytest.approx(K[0, 0], rel=1e-5)
        assert component.fy == pytest.approx(K[1, 1], rel=1e-5)


@pytest.mark.sim
def test_object_is_drawn_where_it_projects_to(small_renderer, expert_run) -> None:  # type: ignore[no-untyped-def]
    scene: SceneSpec = expert_run.scene
    moment = moment_at(expert_run.trajectory, 0)
    small_renderer.set_scene(scene)
    frames = small_renderer.render(moment)
    off_px = []
    for row, obj in enumerate(scene.objects):
        if obj not in scene.pickable:
            continue
        vertices = np.asarray(small_renderer.task.geometry(obj).visual.vertices)
        points_world = apply_transform(expert_run.trajectory.T_world_object(obj.id, 0), vertices)
        for name, (K, T) in small_renderer.parameters.items():
            seen = frames[name].object_index == row
            uv, depth_m = project(points_world, K, T)
            box = np.stack([uv.min(axis=0), uv.max(axis=0)])
            whole = (box[0] > 0).all() and (box[1] < [159, 119]).all()
            if not whole or seen.sum() < 0.7 * np.prod(box[1] - box[0]):
                continue  # cut by the border or hidden by the arm
            v, u = np.nonzero(seen)
            drawn = np.array([[u.min(), v.min()], [u.max(), v.max()]])
            np.testing.assert_allclose(drawn, box, atol=1.5)
            off_px.append(drawn.mean(axis=0) - box.mean(axis=0))
            reading = frames[name].depth_m[seen]
            assert depth_m.min() - 2e-3 < reading.min() and reading.max() < depth_m.max() + 2e-3
    assert len(off_px) >= 3
    # Pixel centres lie on whole numbers: the other convention would be off by half a pixel.
    np.testing.assert_allclose(np.mean(off_px, axis=0), 0.0, atol=0.25)


@pytest.mark.sim
def test_clouds_of_all_cameras_meet_on_the_table(small_renderer, expert_run) -> None:  # type: ignore[no-untyped-def]
    small_renderer.set_scene(expert_run.scene)
    frames = small_renderer.render(moment_at(expert_run.trajectory, 0))
    for name, (K, T) in small_renderer.parameters.items():
        points, _ = backproject_depth(frames[name].depth_m, K, T)
        on_table = points[(np.abs(points[:, 0]) < 0.2) & (np.abs(points[:, 1] - 0.05) < 0.2)]
        flat = on_table[np.abs(on_table[:, 2]) < 0.01]
        assert len(flat) > 100, name
        assert abs(np.median(flat[:, 2])) < 1.5e-3, name
