"""Every kind of damage that `validate` knows is done once to a whole run, and named by its kind."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from codediffuser.datagen import episode_check
from codediffuser.datagen.trajectory import ACTION_NAMES
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.export_meta import DOCUMENT
from codediffuser.datasets.exporting.video import VideoConfig
from codediffuser.datasets.features import ACTION, LABELS, POINTS, STATE
from codediffuser.datasets.validate import as_json, validate
from codediffuser.files import sha256_file
from codediffuser.labeling.store import load_labels, save_labels

ROOT = Path(__file__).resolve().parents[2]
DATA = "lerobot/data/chunk-000/file-000.parquet"
EPISODE = "episodes/000001"


def kinds(path: Path) -> set[str]:
    return {finding.kind for finding in validate(path)}


def edit_json(path: Path, change: Callable[[dict], None]) -> None:
    raw = json.loads(path.read_text())
    change(raw)
    path.write_text(json.dumps(raw))


def edit_rows(run: Path, key: str, change: Callable[[np.ndarray], None]) -> None:
    """Rewrite one column of the data file; `change` works on the (T, D) array in place."""
    table = pq.read_table(run / DATA)
    at = table.schema.get_field_index(key)
    values = np.array(table.column(at).to_pylist())
    change(values)
    column = pa.array(values.tolist(), table.schema.field(at).type)
    pq.write_table(table.set_column(at, table.schema.field(at), column), run / DATA)


def edit_meta(run: Path, change: Callable[[list[dict]], None]) -> None:
    path = run / "lerobot/meta/episodes/chunk-000/file-000.parquet"
    rows = pq.read_table(path).to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows), path)


def accept_bytes(folder: Path) -> None:
    """Hash the files of an episode anew, as somebody would who edits one by hand."""

    def change(manifest: dict) -> None:
        for name in manifest["files"]:
            path = folder / name
            manifest["files"][name] = {"bytes": path.stat().st_size, "sha256": sha256_file(path)}

    edit_json(folder / "episode.json", change)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def cut_log(run: Path) -> None:
    cut(run / EPISODE / "episode.mcap")
    accept_bytes(run / EPISODE)


def other_states(run: Path) -> None:
    shutil.copy(run / "episodes/000002/states.npz", run / EPISODE / "states.npz")
    accept_bytes(run / EPISODE)


def manifest(**changes: object) -> Callable[[Path], None]:
    return lambda run: edit_json(run / EPISODE / "episode.json", lambda raw: raw.update(changes))


def more_messages(run: Path) -> None:
    def change(raw: dict) -> None:
        raw["topics"][next(iter(raw["topics"]))] += 1

    edit_json(run / EPISODE / "episode.json", change)


def failed_condition(run: Path) -> None:
    condition = {"name": "upright", "value": 0.1, "threshold": 0.99, "holds": False}
    manifest(conditions=[condition])(run)


def label_elsewhere(run: Path) -> None:
    pick, place = load_labels(run / EPISODE).labels
    save_labels(run / EPISODE, [replace(pick, points_world=pick.points_world + 1), place])


def label_of_less(run: Path) -> None:
    pick, place = load_labels(run / EPISODE).labels
    save_labels(run / EPISODE, [pick, replace(place, points_world=place.points_world[1:])])


def info(**changes: object) -> Callable[[Path], None]:
    return lambda run: edit_json(run / "lerobot/meta/info.json", lambda raw: raw.update(changes))


def short_action(run: Path) -> None:
    edit_json(run / "lerobot/meta/info.json", lambda raw: raw["features"][ACTION].update(shape=[7]))


def wrong_mean(run: Path) -> None:
    def change(raw: dict) -> None:
        raw[STATE]["mean"][0] += 0.1

    edit_json(run / "lerobot/meta/stats.json", change)


def rows(key: str, change: Callable[[np.ndarray], None]) -> Callable[[Path], None]:
    return lambda run: edit_rows(run, key, change)


def repeat_motion(run: Path) -> None:
    """Give the second episode the motion of the first, as far as it goes."""
    lengths = [row["length"] for row in read_meta(run)]
    n = min(lengths[:2])
    assert lengths[0] == n

    def change(values: np.ndarray) -> None:
        values[lengths[0] : lengths[0] + n] = values[:n]

    edit_rows(run, STATE, change)
    edit_rows(run, ACTION, change)
    edit_meta(run, lambda all_rows: all_rows[1].update(length=n))


def read_meta(run: Path) -> list[dict]:
    return pq.read_table(run / "lerobot/meta/episodes/chunk-000/file-000.parquet").to_pylist()


FAULTS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "a killed process left a file": (
        "run.leftover", lambda run: (run / "episodes/.partial-1-000009").mkdir()),
    "a scene was never demonstrated": ("run.scene-open", lambda run: (
        (run / "scenes").mkdir(exist_ok=True),
        shutil.copy(run / EPISODE / "scene.yaml", run / "scenes/000007.yaml"))),
    "an episode was copied": ("run.duplicate", lambda run: shutil.copytree(
        run / EPISODE, run / "episodes/000009")),
    "a manifest is no JSON": (
        "episode.manifest", lambda run: (run / EPISODE / "episode.json").write_text("{")),
    "a file of an episode is gone": (
        "episode.file-missing", lambda run: (run / EPISODE / "states.npz").unlink()),
    "a log was cut": ("episode.bytes", lambda run: cut(run / EPISODE / "episode.mcap")),
    "a bit was flipped": ("episode.hash", lambda run: flip(run / EPISODE / "states.npz")),
    "a cut log was hashed anew": ("episode.unreadable", cut_log),
    "messages are lacking": ("episode.messages", more_messages),
    "another clock": ("episode.time", manifest(hz=30)),
    "states of another episode": ("episode.states", other_states),
    "another instruction": ("episode.scene", manifest(instruction="Put it back.")),
    "a folder was renamed": ("episode.renamed", lambda run: (
        run / EPISODE).rename(run / "episodes/000009")),
    "a success that is none": ("episode.outcome", failed_condition),
    "labels are gone": ("label.missing", lambda run: (run / EPISODE / "labels.json").unlink()),
    "labels are no JSON": (
        "label.damaged", lambda run: (run / EPISODE / "labels.json").write_text("{")),
    "a label lies elsewhere": ("label.scene", label_elsewhere),
    "labels changed since": ("export.outdated", label_of_less),
    "an episode came later": ("export.episodes", lambda run: shutil.rmtree(run / EPISODE)),
    "a data file is gone": ("dataset.file-missing", lambda run: (run / DATA).unlink()),
    "a data file was cut": ("dataset.unreadable", lambda run: cut(run / DATA)),
    "wrong totals": ("dataset.counts", info(total_frames=19)),
    "a gap between episodes": ("dataset.episodes-gap", lambda run: edit_meta(
        run, lambda all_rows: all_rows[1].update(dataset_from_index=99))),
    "metadata names more frames": ("dataset.frames-missing", lambda run: edit_meta(
        run, lambda all_rows: all_rows[-1].update(length=all_rows[-1]["length"] + 2))),
    "a wrong shape": ("dataset.shape", short_action),
    "rows of another episode": (
        "dataset.row-numbers", rows("episode_index", lambda v: v.__setitem__(7, 0))),
    "time goes back": ("dataset.time", rows("timestamp", lambda v: v.__setitem__(7, 0.0))),
    "a NaN": ("dataset.not-finite", rows(STATE, lambda v: v.__setitem__((7, 1), np.nan))),
    "a jump": ("dataset.action-jump", rows(
        ACTION, lambda v: v.__setitem__((7, 1), v[7, 1] + 0.5))),
    "no rotation": ("dataset.rotation", rows(
        ACTION, lambda v: v.__setitem__((7, slice(3, 9)), 0))),
    "points in millimetres": ("dataset.far-points", rows(
        POINTS, lambda v: v.__setitem__((7, 0), 90.0))),
    "attention of 2": (
        "dataset.attention-range", rows(POINTS, lambda v: v.__setitem__((7, 3), 2.0))),
    "nothing attended": ("dataset.no-attention", rows(
        POINTS, lambda v: v.__setitem__((7, slice(3, None, 5)), 0.0))),
    "the same motion twice": ("dataset.duplicate", repeat_motion),
    "wrong statistics": ("dataset.stats", wrong_mean),
    "a file was added": ("dataset.changed", lambda run: (
        run / "lerobot/meta/note.txt").write_text("hello")),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_damage_is_named(exported_run: Path, fault: str) -> None:
    kind, damage = FAULTS[fault]
    assert not kinds(exported_run)
    damage(exported_run)
    assert kind in kinds(exported_run)


@pytest.mark.parametrize(
    ("seconds", "travel_m", "source", "found"),
    [
        (2.0, 0.2, "real", True),
        (2.0, 0.0, "real", False),
        (0.5, 0.2, "real", False),
        (2.0, 0.2, "simulation", False),  # rendered: the hand was out of view
    ],
)
def test_a_camera_hangs_when_it_repeats_itself_while_the_hand_moves(
    tmp_path: Path, seconds: float, travel_m: float, source: str, found: bool
) -> None:
    hz, frames = 25, 75
    rng = np.random.default_rng(0)
    still = int(seconds * hz)
    shown = [rng.integers(9, 255, (6, 8, 3), dtype=np.uint8) for _ in range(frames)]
    shown[10 : 10 + still] = [shown[10]] * still
    actions = np.zeros((frames, 10))
    actions[:, 0] = np.linspace(0, travel_m * frames / still, frames)
    episode = SimpleNamespace(
        log_path=tmp_path / "episode.mcap", remedy="record again", actions=actions,
        manifest=SimpleNamespace(
            hz=hz, source=source,
            cameras=[SimpleNamespace(name="left", height=6, width=8, depth=False)],
            motion=SimpleNamespace(action_names=ACTION_NAMES),
        ),
        frames=lambda: (
            SimpleNamespace(index=k, rgb={"left": p}, depth_m={"left": np.zeros((6, 8))})
            for k, p in enumerate(shown)
        ),
    )  # fmt: skip
    told = [f.kind for f in episode_check._check_pictures(episode)]
    assert told == (["episode.frozen"] if found else [])


def wandering(frame: int) -> np.ndarray:
    """A picture like no other: a bright square that wanders over a ramp."""
    shown = np.tile(np.linspace(40, 120, 48, dtype=np.uint8)[None, :, None], (32, 1, 3))
    shown[8:24, 2 * frame : 2 * frame + 10] = 220
    return shown


def rewrite_video_times(root: Path) -> None:
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    all_rows = pq.read_table(path).to_pylist()
    all_rows[1]["videos/observation.images.cam/to_timestamp"] += 1.0
    pq.write_table(pa.Table.from_pylist(all_rows), path)


def other_frame_rate(root: Path) -> None:
    edit_json(root / "meta/info.json", lambda raw: raw.update(fps=5))


@pytest.mark.parametrize(
    ("kind", "picture", "damage"),
    [
        ("video.black", lambda k: wandering(k) * (k != 7), None),
        ("video.frozen", lambda k: wandering(min(k, 4)), None),
        ("video.length", wandering, rewrite_video_times),
        ("video.time", wandering, other_frame_rate),
        ("video.unreadable", wandering, lambda root: next(root.rglob("*.mp4")).write_bytes(b"no")),
    ],
)
def test_pictures_that_do_not_fit_are_named(
    tmp_path: Path, make_video_dataset: Callable[..., Path], kind: str,
    picture: Callable[[int], np.ndarray], damage: Callable[[Path], None] | None,
) -> None:  # fmt: skip
    good = make_video_dataset(tmp_path / "good", frames=20, picture=wandering)
    assert not kinds(good)
    bad = good
    if damage is None:
        bad = make_video_dataset(tmp_path / "bad", frames=20, picture=picture)
    else:
        damage(bad)
    assert kind in kinds(bad)


def test_pictures_of_hidden_targets_are_not_accused_of_being_black(
    labelled_run: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = labelled_run(2)
    monkeypatch.setattr(
        "codediffuser.datasets.exporting.source.role_masks",
        lambda points, attention, camera, depth, **_: np.zeros(
            (2, camera.height, camera.width), dtype=bool
        ),
    )
    list(convert_run(run, profile="masked-rgb", video=VideoConfig(codec="h264")))
    root = run / "exports" / "lerobot-masked-rgb"
    assert not kinds(root)
    (root / DOCUMENT).unlink()  # as LeRobot's edit tools leave it
    assert not kinds(root)


def test_masked_pictures_are_known_when_a_stock_tool_has_removed_the_labels(
    labelled_run: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from lerobot.datasets.dataset_tools import remove_feature
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    def seen_now_and_then(*arguments: Any, **_: Any) -> np.ndarray:
        camera = arguments[2]
        masks = np.zeros((2, camera.height, camera.width), dtype=bool)
        calls.append(1)
        masks[:, : camera.height // 3, : camera.width // 3] = len(calls) % 3 == 0
        return masks

    calls: list[int] = []
    run = labelled_run(2)
    monkeypatch.setattr("codediffuser.datasets.exporting.source.role_masks", seen_now_and_then)
    list(convert_run(run, profile="masked-rgb", video=VideoConfig(codec="h264")))
    whole = LeRobotDataset("me/masked", root=run / "exports" / "lerobot-masked-rgb")
    thin = tmp_path / "thin"
    remove_feature(whole, [LABELS], output_dir=thin, repo_id="me/thin")
    assert not kinds(thin)


def test_a_clean_run_is_not_accused_and_json_says_so(exported_run: Path) -> None:
    found = as_json(exported_run, list(validate(exported_run)))
    assert found["kinds"] == {} and found["findings"] == []


def test_json_counts_by_kind(exported_run: Path) -> None:
    wrong_mean(exported_run)
    found = as_json(exported_run, list(validate(exported_run)))
    assert found["schema"] == "codediffuser.findings/1"
    assert found["kinds"]["dataset.stats"] == 1
    first = found["findings"][0]
    assert set(first) == {"kind", "where", "what", "remedy"}


def test_the_documentation_lists_every_kind() -> None:
    told = set(re.findall(r"^\| `([a-z.-]+)` \|", (ROOT / "docs/keeping.md").read_text(), re.M))
    sources = [ROOT / "datagen/episode_check.py", *(ROOT / "datasets").rglob("checks/*.py")]
    raised = set()
    for path in sources:
        raised |= set(re.findall(r'"((?:run|episode|label|export|dataset|video)\.[a-z-]+)"',
                                 path.read_text()))  # fmt: skip
    assert told == raised
