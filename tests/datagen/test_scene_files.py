import json
import os
from pathlib import Path
from typing import Any

import pytest

from codediffuser.datagen.reset_image import render_png
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_files import sample_scenes
from codediffuser.datagen.scene_sampler import SceneSource
from codediffuser.datagen.scene_summary import SampleSummary
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import ConfigError


def folder_bytes(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def source(task: PackBattery, seed: int = 11, **settings: Any) -> SceneSource:
    return SceneSource(task, SamplingSettings(root_seed=seed, **settings))


def test_workers_and_order_change_no_byte(pack_battery: PackBattery, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    paths = list(sample_scenes(source(pack_battery), one, 6))
    assert paths == [one / f"{i:06d}.yaml" for i in range(6)]
    out_of_order = source(pack_battery).draw(4)
    list(sample_scenes(source(pack_battery), two, 6, workers=2))
    assert folder_bytes(one) == folder_bytes(two)
    assert SceneSpec.load(one / "000004.yaml") == out_of_order


def test_each_scene_has_a_picture_and_the_set_a_summary(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    list(sample_scenes(source(pack_battery), tmp_path, 2))
    names = [f"00000{i}.{suffix}" for i in range(2) for suffix in ("png", "yaml")]
    assert {*names, "summary.json"} <= set(folder_bytes(tmp_path))
    scene = SceneSpec.load(tmp_path / "000001.yaml")
    picture = (tmp_path / "000001.png").read_bytes()
    assert picture == render_png(pack_battery.draw_reset(scene))


def test_pictures_can_be_left_out(pack_battery: PackBattery, tmp_path: Path) -> None:
    list(sample_scenes(source(pack_battery), tmp_path, 2, pictures=False))
    assert list(folder_bytes(tmp_path)) == ["000000.yaml", "000001.yaml", "summary.json"]


def test_running_again_draws_only_what_is_missing(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    list(sample_scenes(source(pack_battery), tmp_path, 3))
    whole = folder_bytes(tmp_path)
    (tmp_path / "000001.png").unlink()
    (tmp_path / "000002.yaml").unlink()
    (tmp_path / ".partial-999999999-000002.yaml").write_text("killed here")
    kept = os.stat(tmp_path / "000000.png").st_mtime_ns
    list(sample_scenes(source(pack_battery), tmp_path, 3))
    assert folder_bytes(tmp_path) == whole
    assert os.stat(tmp_path / "000000.png").st_mtime_ns == kept


def test_scenes_of_another_seed_are_not_mixed_in_unless_overwritten(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    list(sample_scenes(source(pack_battery, 11), tmp_path, 1, pictures=False))
    (tmp_path / "summary.json").unlink()  # As if it had been stopped before its end.
    other = source(pack_battery, 12)
    with pytest.raises(
        ConfigError, match=r"holds a scene with seed 11, expected 12; .*--overwrite"
    ):
        list(sample_scenes(other, tmp_path, 1, pictures=False))
    list(sample_scenes(other, tmp_path, 1, pictures=False, overwrite=True))
    assert SceneSpec.load(tmp_path / "000000.yaml").seed.root == 12


def test_a_finished_set_refuses_other_settings_that_no_scene_shows(
    pack_battery: PackBattery, tmp_path: Path
) -> None:
    list(sample_scenes(source(pack_battery), tmp_path, 1, pictures=False))
    changed = source(pack_battery, stratify=("kind",))
    with pytest.raises(ConfigError, match=r"summary\.json: holds scenes with stratify \(\),"):
        list(sample_scenes(changed, tmp_path, 1, pictures=False))


def test_the_summary_counts_what_the_files_say(pack_battery: PackBattery, tmp_path: Path) -> None:
    settings: dict[str, Any] = {"split": "train", "template_split": "seen"}
    paths = list(sample_scenes(source(pack_battery, **settings), tmp_path, 12, pictures=False))
    scenes = [SceneSpec.load(path) for path in paths]
    summary = SampleSummary.load(tmp_path / "summary.json")
    said = [s.instruction for s in scenes]
    assert summary.scenes == 12
    assert summary.settings.split == "train"
    for kind, count in summary.kinds.items():
        assert count == sum(i.kind == kind for i in said)
    assert sum(summary.templates.values()) == 12
    assert summary.template_splits == {"seen": 12}
    spoken = [
        w for i in said for p, w in i.components.items() if p.removeprefix("other_") == "slot"
    ]
    assert summary.components["slot"] == {w: spoken.count(w) for w in sorted(set(spoken))}
    assert sum(summary.target_places.values()) == 12
    assert summary.picks_x_places.keys() == {
        f"{s.ambiguity.picks} x {s.ambiguity.places}" for s in scenes
    }
    histogram = summary.target_start_x
    starts = [s.object(s.target.pick).position_m[0] for s in scenes]
    first = sum(histogram.start_m <= x < histogram.start_m + histogram.bin_m for x in starts)
    assert sum(histogram.counts) == 12
    assert histogram.counts[0] == first
    raw = json.loads((tmp_path / "summary.json").read_text())
    assert raw["schema"] == "codediffuser.sample_summary/1"
    assert str(tmp_path) not in (tmp_path / "summary.json").read_text()
