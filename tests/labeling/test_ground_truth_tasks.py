"""Ground-truth labels of every task, on clouds that are drawn from the bodies themselves."""

import numpy as np
import pytest

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import TASKS, Task
from codediffuser.labeling.ground_truth import ground_truth_labels
from codediffuser.poses import apply_transform

POINTS_PER_BODY = 4000


@pytest.fixture(scope="module", params=TASKS.names())
def task(request: pytest.FixtureRequest) -> Task:
    return TASKS.get(request.param)()


def cloud_of(task: Task, scene: SceneSpec) -> dict[str, np.ndarray]:
    """Points (N, 3) float32 on the surface of each object at its reset pose, by id."""
    import trimesh

    found = {}
    for number, obj in enumerate(scene.objects):
        mesh = trimesh.util.concatenate(list(task.geometry(obj).collision))
        points, _ = trimesh.sample.sample_surface(mesh, POINTS_PER_BODY, seed=number)
        found[obj.id] = apply_transform(obj.T_world_object, points).astype(np.float32)
    return found


def test_labels_hold_the_target_and_its_place_and_nothing_else_that_moves(task: Task) -> None:
    for index in range(2):
        scene = sample_scene(task, root_seed=4, index=index)
        bodies = cloud_of(task, scene)
        cloud = np.concatenate(list(bodies.values()))
        pick, place = ground_truth_labels(task, scene, {}, cloud)
        own = {tuple(p) for p in bodies[scene.target.pick]}
        assert np.mean([tuple(p) in own for p in pick.points_world]) > 0.99
        movable = {tuple(p) for o in scene.objects if not o.fixed for p in bodies[o.id]}
        assert not any(tuple(p) in movable for p in place.points_world)
        region = scene.place(scene.target.place)
        off = np.abs(place.points_world - np.array(region.center_m))
        assert np.all(off <= np.array(region.size_m) / 2 + 1e-6)
