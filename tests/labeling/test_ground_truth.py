"""Labels from the simulator hold the target's points and nobody else's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datagen.scene import ObjectSpec, SceneSpec
from codediffuser.datagen.task import get_task
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import EpisodeError, LabelError
from codediffuser.labeling.auto import label_episode, label_run, start_cloud
from codediffuser.labeling.ground_truth import (
    GroundTruthConfig,
    ground_truth_labels,
    signed_distance_m,
)
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.store import LABELS, POINTS, load_labels, save_labels
from codediffuser.poses import make_transform

TASK = get_task("pack_battery")


def on_cylinder(x: float, y: float, count: int = 400, seed: int = 0) -> np.ndarray:
    """Points on the side of a standing battery at (x, y)."""
    rng = np.random.default_rng(seed)
    angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.005, 0.055, count)
    radius = 0.015
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle), height]).astype(
        np.float32
    )


def slot_points(scene: SceneSpec) -> np.ndarray:
    place = scene.place(scene.target.place)
    rng = np.random.default_rng(1)
    half = np.array(place.size_m) / 2
    return (np.array(place.center_m) + rng.uniform(-half, half, (100, 3))).astype(np.float32)


def with_neighbour(scene: SceneSpec, x: float, y: float) -> SceneSpec:
    other = ObjectSpec(
        id="battery_1", category="battery", name="blue battery", position_m=(x, y, 0.0),
        color_rgb=(0, 0, 1),
    )  # fmt: skip
    return scene.model_copy(update={"objects": (*scene.objects, other)})


def test_points_of_the_target_are_found_whole(small_scene: SceneSpec) -> None:
    own, other = on_cylinder(0, 0), on_cylinder(0.05, 0, seed=1)
    cloud = np.concatenate([own, other, slot_points(small_scene)])
    scene = with_neighbour(small_scene, 0.05, 0)
    pick, place = ground_truth_labels(TASK, scene, {}, cloud)
    assert np.array_equal(pick.points_world, own)
    assert (pick.role, pick.category, pick.instance_id) == ("pick", "battery", "battery_0")
    assert (place.role, place.category, place.instance_id) == ("place", "slot", "slot_0")
    assert pick.follows == "battery_0" and place.follows is None
    assert pick.provenance.source == "simulator" and pick.provenance.created_at is None


def test_a_touching_neighbour_keeps_its_points(small_scene: SceneSpec) -> None:
    own, other = on_cylinder(0, 0), on_cylinder(0.0305, 0, seed=1)
    scene = with_neighbour(small_scene, 0.0305, 0)
    cloud = np.concatenate([own, other, slot_points(small_scene)])
    pick, _ = ground_truth_labels(TASK, scene, {}, cloud)
    wrong = {tuple(p) for p in other} & {tuple(p) for p in pick.points_world}
    assert not wrong


def test_the_pose_at_frame_0_counts_not_the_scene_file(small_scene: SceneSpec) -> None:
    cloud = np.concatenate([on_cylinder(0.04, 0.01), slot_points(small_scene)])
    start = {"battery_0": make_transform(np.eye(3), np.array([0.04, 0.01, 0.0]))}
    pick, _ = ground_truth_labels(TASK, small_scene, start, cloud)
    assert len(pick.points_world) == 400
    with pytest.raises(LabelError):
        ground_truth_labels(TASK, small_scene, {}, cloud)


def test_a_place_holds_nothing_that_moves(small_scene: SceneSpec) -> None:
    slot = small_scene.place("slot_0")
    x, y = slot.position_m[:2]
    scene = with_neighbour(small_scene, x, y)
    inside = on_cylinder(x, y, seed=2)
    floor = np.column_stack([
        np.random.default_rng(0).uniform(x - 0.02, x + 0.02, 50),
        np.full(50, y + 0.0205), np.full(50, 0.03),
    ]).astype(np.float32)  # fmt: skip
    cloud = np.concatenate([on_cylinder(0, 0), inside, floor])
    _, place = ground_truth_labels(TASK, scene, {}, cloud)
    assert len(place.points_world) == 50
    assert np.allclose(place.points_world[:, 1], y + 0.0205)


@pytest.mark.parametrize(("role", "name"), [("pick", "battery_0"), ("place", "slot_0")])
def test_a_hidden_target_is_an_error_that_names_it(
    small_scene: SceneSpec, role: str, name: str
) -> None:
    seen = slot_points(small_scene) if role == "pick" else on_cylinder(0, 0)
    with pytest.raises(LabelError, match=rf"000042.*at least 20 points of .* '{name}'.*got 0"):
        ground_truth_labels(TASK, small_scene, {}, seen)


def test_many_points_are_thinned_to_the_limit(small_scene: SceneSpec) -> None:
    cloud = np.concatenate([on_cylinder(0, 0, 5000), slot_points(small_scene)])
    config = GroundTruthConfig(max_points=64)
    pick, place = ground_truth_labels(TASK, small_scene, {}, cloud, config)
    assert len(pick.points_world) == len(place.points_world) == 64


def test_signed_distance_of_a_box_and_of_two_parts() -> None:
    import trimesh

    box = trimesh.creation.box(extents=(2, 2, 2))
    shifted = box.copy().apply_translation((4, 0, 0))
    points = np.array([[0, 0, 0], [1, 0, 0], [1.5, 0, 0], [4, 0, 0.5]], dtype=float)
    assert np.allclose(signed_distance_m(points, [box]), [-1, 0, 0.5, 3])
    assert np.allclose(signed_distance_m(points, [box, shifted]), [-1, 0, 0.5, -0.5])
    assert np.isinf(signed_distance_m(points, [])).all()


def test_a_labelled_episode_points_at_its_targets(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    folder = write_battery_episode(tmp_path)
    labels = label_episode(folder)
    episode = Episode.open(folder)
    battery = episode.trajectory.T_world_object("battery_0", 0)[:3, 3]
    slot = np.array(episode.scene.place("slot_0").center_m)
    assert np.linalg.norm(labels["pick"].points_world.mean(axis=0)[:2] - battery[:2]) < 0.005
    assert np.abs(labels["place"].points_world - slot).max() <= 0.026
    assert len(start_cloud(episode, TASK)) > 500


def test_labels_of_a_run_are_the_same_bytes_for_any_worker_count(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    def label_all(run: Path, workers: int) -> dict[str, bytes]:
        for episode_id in ("000001", "000002"):
            write_battery_episode(run, episode_id)
        results = list(label_run(run, workers=workers))
        assert {r.episode_id for r in results} == {"000001", "000002"}
        assert all(not r.error and r.num_points["pick"] >= 20 for r in results)
        files = [p for name in (LABELS, POINTS) for p in run.rglob(name)]
        return {str(p.relative_to(run)): p.read_bytes() for p in files}

    one = label_all(tmp_path / "one", 1)
    assert len(one) == 4
    assert one == label_all(tmp_path / "two", 2)


def test_labelling_again_keeps_what_is_there(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    folder = write_battery_episode(tmp_path)
    first = label_episode(folder)
    save_labels(folder, [first["pick"], replace(first["place"], instance_id="slot_1")])
    assert label_episode(folder)["place"].instance_id == "slot_1"
    again = label_episode(folder, overwrite=True)
    assert (again["place"].instance_id, again.revision) == ("slot_0", 3)


def test_an_episode_that_shows_too_little_is_a_result_with_an_error(
    tmp_path: Path, write_synthetic_episode: Callable[..., tuple[Path, Trajectory, list[object]]]
) -> None:
    write_synthetic_episode(tmp_path)
    (result,) = label_run(tmp_path)
    assert "expected at least 20 points" in result.error and not result.num_points


def test_a_run_without_episodes_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="run `codediffuser demo"):
        next(label_run(tmp_path))


def test_motion_gives_the_poses_of_followed_objects(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    folder = write_battery_episode(tmp_path)
    labels = label_episode(folder).labels
    episode = Episode.open(folder)
    motion = RecordedMotion(episode, labels)
    for frame in (0, 3):
        expected = episode.trajectory.T_world_object("battery_0", frame)
        assert np.array_equal(motion.at(frame)["battery_0"], expected)
    assert RecordedMotion(episode, [labels[1]]).at(0) == {}


def test_motion_of_an_unrecorded_object_is_an_error(
    tmp_path: Path, write_battery_episode: Callable[..., Path]
) -> None:
    folder = write_battery_episode(tmp_path)
    pick = label_episode(folder)["pick"]
    with pytest.raises(LabelError, match=r"'crate', which did not move.*recorded are: battery_0"):
        RecordedMotion(Episode.open(folder), [replace(pick, follows="crate")])
    assert load_labels(folder).revision == 1
