"""Episodes as the simulator records them: flawless, killed, seen by other cameras, drawn later."""

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from codediffuser.datagen import collect
from codediffuser.datagen.collect import CollectOptions
from codediffuser.datagen.demo_results import DemoFailure, failure_path
from codediffuser.datagen.episode import Episode, load_manifest
from codediffuser.datagen.episode_check import check_episode
from codediffuser.datagen.pictures import (
    NamedRanges,
    PictureOptions,
    depth_to_mm,
    stored_appearance,
)
from codediffuser.datagen.randomization import load_randomization
from codediffuser.datagen.record import DemoJob, record_demo, rerender_episode
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.datagen.task_config import CameraConfig
from codediffuser.datagen.workers import Outcome
from codediffuser.errors import ConfigError, RenderError

IDS = ("000000", "000001", "000002")

# One small camera: what is tested is the recording, not the pictures.
ONE_CAMERA = PictureOptions(
    cameras=CameraConfig(
        width=32, height=24, views=get_task("pack_battery").config.cameras.views[:1]
    )
)


def test_depth_is_rounded_to_whole_millimetres():
    depth_m = np.array([[0.0, 0.0014, 0.0016, 5.0, 99.0]], dtype=np.float32)
    assert depth_to_mm(depth_m).tolist() == [[0, 1, 2, 5000, 65535]]


def write_scenes(run, count=3):
    task = get_task("pack_battery")
    for index in range(count):
        scene = sample_scene(task, root_seed=3, index=index)
        scene.save(run / "scenes" / f"{scene.scene_id}.yaml")


@pytest.fixture(scope="module")
def collected(tmp_path_factory):
    """Three scenes collected without interruption by one process."""
    run = tmp_path_factory.mktemp("collected")
    write_scenes(run)
    results = list(collect.collect_demos(run, CollectOptions(pictures=ONE_CAMERA)))
    assert [r.success for r in results] == [True] * 3
    return run


@pytest.mark.sim
@pytest.mark.slow
def test_collected_episodes_are_flawless_and_their_pictures_those_of_the_renderer(collected):
    from codediffuser.datagen.rendering import Renderer
    from codediffuser.datagen.views import moment_at

    for scene_id in IDS:
        assert check_episode(collected / "episodes" / scene_id) == []
    episode = Episode.open(collected / "episodes" / IDS[0], verify=True)
    assert (episode.num_frames, list(episode.cameras)) == (185, ["left_bottom"])
    renderer = Renderer(get_task("pack_battery"), ONE_CAMERA.cameras)
    renderer.set_scene(episode.scene)
    seen = renderer.render(moment_at(episode.trajectory, 100))["left_bottom"]
    stored = episode.frame(100)
    np.testing.assert_array_equal(stored.depth_m["left_bottom"], seen.depth_m)
    # JPEG is lossy; at this size single pixels are off by more.
    error = np.abs(stored.rgb["left_bottom"].astype(int) - seen.rgb)
    assert error.mean() < 8


@pytest.mark.sim
@pytest.mark.slow
def test_killed_twice_two_processes_end_with_the_bytes_of_one_uninterrupted(collected, tmp_path):
    write_scenes(tmp_path)
    episodes = tmp_path / "episodes"
    _kill_when(tmp_path, 1, lambda: any(episodes.glob(".partial-*/episode.mcap")))
    assert not any(episodes.glob("0*"))
    _kill_when(tmp_path, 2, lambda: any(episodes.glob("0*/episode.json")))
    whole = sorted(episodes.glob("0*"))
    assert [check_episode(folder) for folder in whole] == [[]] * len(whole)
    results = list(collect.collect_demos(tmp_path, CollectOptions(pictures=ONE_CAMERA), workers=2))
    assert {r.scene_id for r in results if r.earlier} == {folder.name for folder in whole}
    assert sorted(r.scene_id for r in results) == list(IDS)
    assert {p.name for p in episodes.iterdir()} == set(IDS)
    for name in ("states.npz", "scene.yaml", "episode.mcap"):
        for scene_id in IDS:
            path = f"episodes/{scene_id}/{name}"
            assert (tmp_path / path).read_bytes() == (collected / path).read_bytes(), path


def test_a_scene_under_another_name_is_refused(tmp_path, small_scene):
    job = DemoJob(tmp_path, IDS[0], ONE_CAMERA)
    small_scene.save(job.scene_file)
    with pytest.raises(
        ConfigError, match="expected scene_id '000000' as its name says, got '000042'"
    ):
        record_demo(job)


@pytest.mark.sim
def test_an_unreachable_object_is_a_recorded_failure(tmp_path):
    write_scenes(tmp_path, count=1)
    job = DemoJob(tmp_path, IDS[0], ONE_CAMERA)
    scene = SceneSpec.load(job.scene_file)
    far = [
        o.model_copy(update={"position_m": (0.3, 0.85, 0.0)}) if o.id == scene.target.pick else o
        for o in scene.objects
    ]
    scene.model_copy(update={"objects": tuple(far)}).save(job.scene_file)
    job.folder.mkdir(parents=True)
    result = record_demo(job)
    assert not result.success
    assert result.phase.endswith(":unreachable")
    assert "no joint angles reach" in result.reason
    failure = DemoFailure.load(failure_path(tmp_path, IDS[0]))
    assert (failure.phase, failure.repeatable) == (result.phase, True)
    assert not job.folder.exists(), "an older episode of the scene is gone"


@pytest.fixture
def own_copy(collected, tmp_path):
    """One collected episode in a run of its own, without scene files."""
    source = collected / "episodes" / IDS[0]
    shutil.copytree(source, tmp_path / "episodes" / IDS[0])
    return tmp_path


@pytest.mark.sim
def test_a_camera_that_sees_nothing_is_named_and_the_episode_stays(own_copy):
    up = ONE_CAMERA.cameras.views[0].model_copy(update={"look": (0.0, 0.0, 1.0)})
    cameras = ONE_CAMERA.cameras.model_copy(update={"views": (up,)})
    with pytest.raises(RenderError, match=r"camera 'left_bottom' .* sees nothing of the workspace"):
        rerender_episode(DemoJob(own_copy, IDS[0], PictureOptions(cameras=cameras)))
    assert check_episode(own_copy / "episodes" / IDS[0]) == []


@pytest.mark.sim
def test_pictures_are_made_again_in_another_size_and_all_else_stays(own_copy, monkeypatch):
    monkeypatch.setattr(
        collect, "run_tasks", lambda do, jobs, **_: (Outcome(j, do(j), "", 1) for j in jobs)
    )
    folder = own_copy / "episodes" / IDS[0]
    (folder / "labels.json").write_text("{}")
    before = Episode.open(folder)
    larger = PictureOptions(width=64, height=48, cameras=ONE_CAMERA.cameras)
    (result,) = collect.rerender(own_copy, CollectOptions(pictures=larger))
    assert (result.success, result.earlier) == (True, False)
    assert check_episode(folder) == []
    after = Episode.open(folder)
    assert after.frame(0).rgb["left_bottom"].shape == (48, 64, 3)
    assert (folder / "labels.json").read_text() == "{}"
    for name in ("states.npz", "scene.yaml"):
        assert after.manifest.files[name] == before.manifest.files[name]
    for key in ("id", "seed", "instruction", "success", "conditions", "frames"):
        assert getattr(after.manifest, key) == getattr(before.manifest, key)
    (again,) = collect.rerender(own_copy, CollectOptions(pictures=larger))
    assert again.earlier


@pytest.mark.sim
def test_looks_can_be_changed_and_changed_back_to_the_same_bytes(own_copy):
    folder = own_copy / "episodes" / IDS[0]
    strong = NamedRanges(name="strong", ranges=load_randomization("strong"))

    def draw(looks):
        options = ONE_CAMERA.model_copy(update={"looks": looks})
        rerender_episode(DemoJob(own_copy, IDS[0], options))
        assert check_episode(folder) == []
        return Episode.open(folder, verify=True)

    usual = Episode.open(folder)
    stood = usual.cameras["left_bottom"].T_world_camera[:3, 3]
    changed = draw(strong)
    appearance = stored_appearance(changed)
    assert appearance is not None and appearance.ranges == "strong"
    offset = appearance.looks.cameras["left_bottom"].position_m
    moved = changed.cameras["left_bottom"].T_world_camera[:3, 3]
    np.testing.assert_allclose(moved - stood, offset, atol=1e-9)
    kept = draw("stored")
    assert kept.manifest.files == changed.manifest.files
    back = draw("usual")
    assert stored_appearance(back) is None
    assert back.manifest.content_hash == usual.manifest.content_hash


@pytest.mark.sim
def test_physics_first_and_pictures_later_give_what_one_go_gives(collected, tmp_path):
    write_scenes(tmp_path, count=1)
    job = DemoJob(tmp_path, IDS[0], ONE_CAMERA)
    first = record_demo(dataclasses.replace(job, physics_only=True))
    assert (first.success, first.bytes) == (True, 0)
    assert not job.folder.exists()
    second = record_demo(job)
    assert second.physics_s == 0 and second.bytes > 0
    assert not (tmp_path / "physics" / IDS[0]).exists()
    expected = load_manifest(collected / "episodes" / IDS[0])
    assert load_manifest(job.folder).content_hash == expected.content_hash


@pytest.mark.sim
def test_stored_states_of_another_scene_are_simulated_again(tmp_path):
    write_scenes(tmp_path, count=1)
    job = DemoJob(tmp_path, IDS[0], ONE_CAMERA, physics_only=True)
    record_demo(job)
    assert record_demo(job).physics_s == 0
    scene = SceneSpec.load(job.scene_file)
    scene.model_copy(update={"split": "val"}).save(job.scene_file)
    assert record_demo(job).physics_s > 0
    (tmp_path / "physics" / IDS[0] / "states.npz").write_bytes(b"damaged")
    assert record_demo(job).physics_s > 0


def _kill_when(run, workers, is_now):
    """Start collecting and kill it, hard, when the moment has come."""
    cameras = ONE_CAMERA.cameras.model_dump_json()
    script = run / "work.py"
    script.write_text(
        "import sys\n"
        "from pathlib import Path\n"
        "from codediffuser.datagen.collect import CollectOptions, collect_demos\n"
        "from codediffuser.datagen.pictures import PictureOptions\n"
        "from codediffuser.datagen.task_config import CameraConfig\n"
        "if __name__ == '__main__':\n"
        f"    cameras = CameraConfig.model_validate_json({cameras!r})\n"
        "    options = CollectOptions(PictureOptions(cameras=cameras))\n"
        "    print('go', flush=True)\n"
        f"    list(collect_demos(Path({str(run)!r}), options, workers={workers}))\n"
    )
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"go\n"
    end = time.monotonic() + 240
    while not is_now():
        assert process.poll() is None, "ended before the kill"
        assert time.monotonic() < end, "the moment did not come"
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    # Its processes notice as soon as they get to run.
    time.sleep(0.5)
