"""A simulated run that is exported as rosbag2 and imported again is the same run."""

from typing import get_args

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.episode_check import check_episode
from codediffuser.datagen.pictures import PictureOptions
from codediffuser.datagen.record import DemoJob, rerender_episode
from codediffuser.datagen.task import get_task
from codediffuser.datasets.exporting.rosbag2 import export_episode, export_run
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.first_config import guess_config
from codediffuser.datasets.importing.round_trip import RoundTrip, compare, round_trip
from codediffuser.datasets.importing.survey import survey_source
from codediffuser.errors import DatasetError

FORMATS: tuple[RoundTrip, ...] = get_args(RoundTrip)
POSE_TOLERANCE = 1e-6
"""Metres, and parts of a rotation matrix: float32 rows that went through quaternions."""


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_simulated_run_comes_back(storage, tmp_path, write_synthetic_episode, run_import):
    for number in ("000001", "000002"):
        write_synthetic_episode(tmp_path / "sim", number, 12)
    folders = list(export_run(tmp_path / "sim", tmp_path / "bags", storage=storage))
    assert [f.name for f in folders] == ["000001", "000002"]
    # The first guess is all that is needed but for where the scenes are.
    guess = guess_config(survey_source(folders[0]), "pack_battery")
    scenes = {"folder": str(tmp_path / "sim" / "scenes")}
    changes = {"source": "simulation", "scenes": scenes}
    config = ImportConfig.parse(guess | changes, "guess")
    run, results = run_import(tmp_path / "bags", config)
    assert [r.outcome for r in results] == ["imported"] * 2, [r.reason for r in results]
    for folder in list_episodes(run):
        made, again = Episode.open(tmp_path / "sim/episodes" / folder.name), Episode.open(folder)
        assert check_episode(folder) == []
        assert_equal(made, again)


def assert_equal(made: Episode, again: Episode) -> None:
    assert again.num_frames == made.num_frames and again.hz == made.hz
    assert again.manifest.instruction == made.manifest.instruction
    assert again.scene == made.scene
    assert np.abs(again.state - made.state).max() <= POSE_TOLERANCE
    assert np.abs(again.actions - made.actions).max() <= POSE_TOLERANCE
    assert set(again.cameras) == set(made.cameras)
    for name, camera in made.cameras.items():
        assert np.array_equal(again.cameras[name].K, camera.K)
        assert np.abs(again.cameras[name].T_world_camera - camera.T_world_camera).max() <= 1e-12
    for a, b in zip(made.frames(), again.frames(), strict=True):
        for name in made.cameras:
            # JPEG files travel byte for byte, depth is lossless.
            assert np.array_equal(a.rgb[name], b.rgb[name])
            assert np.array_equal(a.depth_m[name], b.depth_m[name])


@pytest.mark.parametrize("to", FORMATS)
def test_exports_come_back(to, tmp_path, labelled_run):
    compared = round_trip(labelled_run(), to, tmp_path / "trip")
    assert (compared.episodes, compared.frames, compared.pictures) == (3, 18, 90)
    assert ("camera" in compared.difference) == (to == "rosbag2")


@pytest.mark.sim
def test_rendered_pictures_come_back_from_every_format(tmp_path, write_battery_episode):
    run = tmp_path / "run"
    write_battery_episode(run, "000001", 3)
    view = get_task("pack_battery").config.cameras
    small = view.model_copy(update={"width": 64, "height": 48, "views": view.views[:2]})
    rerender_episode(DemoJob(run, "000001", PictureOptions(cameras=small)))
    rgb = Episode.open(run / "episodes/000001").frame(0).rgb
    assert all(np.ptp(picture) > 100 for picture in rgb.values())  # rendered, not drawn in grey
    for to in FORMATS:
        compared = round_trip(run, to, tmp_path / to)
        assert (compared.frames, compared.pictures) == (3, 6)


def test_differences_are_told(tmp_path, labelled_run):
    run = labelled_run(1)
    made = [Episode.open(folder) for folder in list_episodes(run)]
    again = [Episode.open(folder) for folder in list_episodes(run)]
    again[0].__dict__["_low_dim"] = (made[0].state + 1e-3, made[0].actions)
    with pytest.raises(DatasetError, match=r"not within tolerance: zarr .* state 1\.0e-03"):
        compare("zarr", made, again, calibrated=False)


def test_any_reader_opens_the_export(tmp_path, write_synthetic_episode):
    folder, _, _ = write_synthetic_episode(tmp_path / "sim", "000001", 3)
    out = export_episode(Episode.open(folder), tmp_path / "bag")
    with AnyReader([out]) as reader:
        assert reader.topics["/joint_states"].msgcount == 3
        connection = reader.topics["/joint_states"].connections[0]
        _, _, data = next(reader.messages([connection]))
        assert reader.deserialize(data, connection.msgtype).name[0] == "panda_joint1"
        static = reader.topics["/tf_static"].connections[0]
        assert static.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
