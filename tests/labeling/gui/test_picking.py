"""A click means the instance with the nearest point, in the plan and through a camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.cameras import project
from codediffuser.datagen.episode_format import Camera
from codediffuser.labeling.gui.episode_scene import EpisodeScene, load_scene
from codediffuser.labeling.gui.picking import Picker, camera_picker, top_picker
from codediffuser.labeling.gui.planes import PicturePlane, Plane, TopPlane, project_to_screen
from codediffuser.labeling.gui.planes import screen_ray as ray_through
from codediffuser.labeling.instances import SelectableInstance, get_instance_source
from codediffuser.poses import look_rotation

CLICKS = 500
ASPECT = 846 / 800


@pytest.fixture
def scene(tmp_path: Path, write_battery_episode: Callable[..., Path]) -> EpisodeScene:
    return load_scene(
        write_battery_episode(tmp_path, num_steps=2), get_instance_source("oracle")
    )  # fmt: skip


def many_instances(seed: int = 0) -> tuple[SelectableInstance, ...]:
    """Twelve slots in a grid and three batteries, as clouds of random points."""
    rng = np.random.default_rng(seed)
    found = []
    for n in range(12):
        middle = [0.042 * (n % 4), 0.042 * (n // 4), 0.02]
        points = np.array(middle) + rng.uniform(-0.02, 0.02, (300, 3))
        found.append(_instance(f"slot_{n}", "place", points))
    for n in range(3):
        points = rng.normal([0.1 * n - 0.05, -0.12, 0.03], 0.008, (200, 3))
        found.append(_instance(f"battery_{n}", "pick", points))
    return tuple(found)


def _instance(name: str, role: object, points: np.ndarray) -> SelectableInstance:
    return SelectableInstance(name, "x", name, role, points.astype(np.float32))  # type: ignore[arg-type]


def window_ray(plane: Plane, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The ray that the browser sends for a click on a point of the plane."""
    viewpoint = plane.viewpoint(ASPECT)
    screen = project_to_screen(plane.to_world(at[None])[0], viewpoint, ASPECT)
    forward = viewpoint.look_at - viewpoint.position
    R = look_rotation(forward, np.cross(forward, viewpoint.up))
    return viewpoint.position, ray_through(np.array(screen), R, viewpoint.fov_y_rad, ASPECT)


def clicks_near(points: np.ndarray, spread: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    chosen = points[rng.integers(len(points), size=CLICKS)]
    return np.asarray(chosen + rng.normal(0, spread, (CLICKS, 2)))


def check_clicks(picker: Picker, plane: Plane, views: list[np.ndarray], spread: float) -> int:
    """Compare every click with a search over all points, done here; how many hit something."""
    hits = 0
    for at in clicks_near(np.concatenate(views), spread, seed=1):
        found = picker.nearest(plane.from_ray(*window_ray(plane, at)))
        distances = [
            np.linalg.norm(p - at, axis=1).min() if len(p) else np.inf for p in views
        ]  # fmt: skip
        best = int(np.argmin(distances))
        if distances[best] > picker.reach:
            assert found is None
            continue
        assert found is not None and found.id == picker.instances[best].id
        hits += 1
    return hits


def test_500_random_clicks_from_above_pick_the_nearest_instance() -> None:
    instances = many_instances()
    picker = top_picker(instances)
    plane = TopPlane.around(instances, np.zeros(3), np.ones(3))
    views = [i.points_world[:, :2].astype(np.float64) for i in instances]
    assert check_clicks(picker, plane, views, spread=0.012) > 0.9 * CLICKS


def test_500_random_clicks_through_a_camera_pick_the_nearest_instance() -> None:
    instances = many_instances()
    camera, depth_m, owner = photograph(instances)
    picker, plane = camera_picker(instances, depth_m, camera), PicturePlane(camera)
    views = [np.argwhere(owner == k)[:, ::-1].astype(np.float64) for k in range(len(instances))]
    assert check_clicks(picker, plane, views, spread=6.0) > 0.9 * CLICKS


def photograph(
    instances: tuple[SelectableInstance, ...],
) -> tuple[Camera, np.ndarray, np.ndarray]:
    """A picture of the instances' points: camera, depth, and whose point each pixel shows."""
    K = np.array([[260.0, 0, 163.0], [0, 260.0, 117.0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = look_rotation(np.array([0.3, 0.4, -0.5]), np.array([1.0, -0.7, 0]))
    T[:3, 3] = [-0.2, -0.3, 0.45]
    camera = Camera(K, T, 320, 240)
    depth_m, owner = np.full((240, 320), np.inf), np.full((240, 320), -1)
    for k, instance in enumerate(instances):
        uv, z = project(instance.points_world, K, T)
        for (u, v), d in zip(np.round(uv).astype(int), z, strict=True):
            if 0 <= u < 320 and 0 <= v < 240 and d < depth_m[v, u]:
                depth_m[v, u], owner[v, u] = d, k
    # What a pixel shows is the point on its ray: the instances are made of just these.
    depth = np.where(np.isinf(depth_m), 0, depth_m).astype(np.float32)
    _replace_points(instances, camera, depth, owner)
    return camera, depth, owner


def _replace_points(
    instances: tuple[SelectableInstance, ...], camera: Camera, depth: np.ndarray, owner: np.ndarray
) -> None:
    from codediffuser.pointcloud import backproject_depth

    seen, pixel = backproject_depth(depth, camera.K, camera.T_world_camera)
    for k, instance in enumerate(instances):
        object.__setattr__(instance, "points_world", seen[owner.reshape(-1)[pixel] == k])


def test_a_real_picture_gives_each_instance_its_own_pixels(scene: EpisodeScene) -> None:
    assert scene.episode is not None
    truth = scene.episode.scene
    for name, camera in scene.cameras.items():
        picker = scene.through(name)
        for number, instance in enumerate(scene.instances):
            pixels = picker.points[picker.owner == number]
            uv, _ = project(instance.points_world, camera.K, camera.T_world_camera)
            low, high = uv.min(axis=0) - 1, uv.max(axis=0) + 1
            assert ((pixels >= low) & (pixels <= high)).all()
    assert {i.id for i in scene.instances} == {"battery_0", "slot_0", "slot_1"}
    assert {i.id for i in scene.instances if i.role == "place"} == {p.id for p in truth.places}


def test_clicks_far_from_everything_select_nothing() -> None:
    picker = top_picker(many_instances())
    assert picker.nearest(np.array([1.0, 1.0])) is None


def test_a_view_of_nothing_picks_nothing() -> None:
    picker = top_picker(())
    assert picker.nearest(np.zeros(2)) is None and picker.inside(-np.ones(2), np.ones(2)) == []
    assert picker.territories(0.01, 0.01) == []


def test_a_box_takes_the_instances_whose_middle_it_holds() -> None:
    picker = top_picker(many_instances())
    inside = picker.inside(np.array([-0.02, -0.02]), np.array([0.06, 0.02]))
    assert [i.id for i in inside] == ["slot_0", "slot_1"]


def test_territories_hold_their_instances() -> None:
    picker = top_picker(many_instances())
    for k, hull in enumerate(picker.territories(0.002, 0.01)):
        points = picker.points[picker.owner == k]
        assert (points.mean(axis=0) >= hull.min(axis=0)).all()
        assert (points.mean(axis=0) <= hull.max(axis=0)).all()


def test_planes_and_rays_are_inverse() -> None:
    instances = many_instances()
    camera, _, _ = photograph(many_instances())
    for plane, at in (
        (TopPlane.around(instances, np.zeros(3), np.ones(3)), np.array([0.05, -0.03])),
        (PicturePlane(camera), np.array([20.0, 200.0])),
    ):
        assert plane.from_ray(*window_ray(plane, at)) == pytest.approx(at, abs=1e-6)


def test_the_whole_picture_fits_the_window() -> None:
    camera, _, _ = photograph(many_instances())
    plane = PicturePlane(camera)
    for aspect in (0.6, 1.0, 2.5):
        for corner in ([0.0, 0.0], [319.0, 239.0], [0.0, 239.0], [319.0, 0.0]):
            world = plane.to_world(np.array([corner]))[0]
            x, y = project_to_screen(world, plane.viewpoint(aspect), aspect)
            assert 0 < x < 1 and 0 < y < 1
