"""The viewers show an episode's own points, pictures and numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.exporting.video import VideoConfig
from codediffuser.datasets.inspecting.app import InspectApp
from codediffuser.datasets.inspecting.dataset_survey import survey_dataset
from codediffuser.datasets.inspecting.dataset_view import dataset_shelf
from codediffuser.datasets.inspecting.episode_view import hand_path, paint
from codediffuser.datasets.inspecting.recorded_view import run_shelf
from codediffuser.datasets.inspecting.rerun_file import write_rerun
from codediffuser.labeling.gui.pictures import PICK_RGB, PLACE_RGB


def attended(rgb: np.ndarray) -> list[int]:
    return [int((rgb == color).all(axis=1).sum()) for color in (PICK_RGB, PLACE_RGB)]


def test_a_run_and_its_export_show_the_same_episode(exported_run: Path) -> None:
    recorded = run_shelf(exported_run).open("000002")
    exported = dataset_shelf(exported_run / "lerobot").open("000002")
    assert np.array_equal(recorded.state, exported.state)
    assert np.array_equal(hand_path(recorded), recorded.state[:, :3])
    assert recorded.names == exported.names
    for view in (recorded, exported):
        shot = view.shot(3)
        assert len(shot.points_world) == len(shot.rgb) > 0
        assert min(attended(shot.rgb)) > 0


@pytest.mark.slow
def test_a_portable_export_shows_the_cloud_of_its_depth_pictures(
    labelled_run: Callable[..., Path],
) -> None:
    run = labelled_run(1)
    for _ in convert_run(run, profile="portable", video=VideoConfig(codec="h264")):
        pass
    root = run / "exports" / "lerobot-portable"
    exported, recorded = dataset_shelf(root).open("000001"), run_shelf(run).open("000001")
    mine, theirs = recorded.shot(2), exported.shot(2)
    assert mine.pictures.keys() == theirs.pictures.keys()
    for name, picture in mine.pictures.items():
        assert np.abs(picture.astype(int) - theirs.pictures[name]).mean() < 4
    assert recorded.cameras.keys() == exported.cameras.keys()
    distance, _ = cKDTree(theirs.points_world).query(mine.points_world)
    assert distance.max() < 1e-4
    assert min(attended(theirs.rgb)) > 0
    assert survey_dataset(root).count("kind") == {"no_slackness": 1}


def test_attention_moves_with_the_object(exported_run: Path) -> None:
    view = run_shelf(exported_run).open("000003")
    middles = []
    for k in (0, 6):
        shot = view.shot(k)
        middles.append(shot.points_world[(shot.rgb == PICK_RGB).all(axis=1)].mean(axis=0))
    assert middles[1][1] - middles[0][1] > 0.1, "the battery went to the back"


def test_paint_leaves_its_input_alone() -> None:
    rgb = np.zeros((2, 3), np.uint8)
    painted = paint(rgb, np.array([[0, 0], [0, 1]]))
    assert painted.tolist() == [[0, 0, 0], list(PLACE_RGB)]
    assert not rgb.any()


def test_a_rerun_file_holds_clouds_pictures_and_curves(exported_run: Path, tmp_path: Path) -> None:
    import rerun as rr

    path = tmp_path / "two.rrd"
    shelf = run_shelf(exported_run)
    views = [shelf.open(name) for name in shelf.ids[:2]]
    assert list(write_rerun(views, path, stride=4)) == list(shelf.ids[:2])
    schema = rr.dataframe.load_recording(path).schema()
    entities = {column.entity_path for column in schema.component_columns()}
    for name in shelf.ids[:2]:
        for part in ("world/cloud", "world/hand/way", "state", "action", "instruction"):
            assert f"/episode_{name}/{part}" in entities
    assert any("/world/cameras/" in entity for entity in entities)


@pytest.fixture
def app(exported_run: Path) -> Iterator[InspectApp]:
    app = InspectApp(run_shelf(exported_run), "run", port=0)
    yield app
    app.close()


def test_the_window_listens_on_this_machine_alone(app: InspectApp) -> None:
    assert app.server.get_host() == "127.0.0.1"
    assert app.url.startswith("http://127.0.0.1:")


def test_the_window_moves_through_frames_and_episodes(app: InspectApp) -> None:
    first = app.shown.points_world
    app.show(4)
    assert app.frame == 4
    assert not np.array_equal(app.shown.points_world, first)
    app.open("000003")
    assert app.frame == 0


def test_a_damaged_episode_says_so_in_the_window(app: InspectApp, exported_run: Path) -> None:
    (exported_run / "episodes" / "000002" / "episode.mcap").write_bytes(b"")
    app.open("000002")
    assert "found 0" in app.message
    app.open("000001")
    assert "success" in app.message
