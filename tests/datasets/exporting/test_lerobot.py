"""LeRobot's picture profiles: lossless where promised, exact statistics, reuse, and the card."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from codediffuser.datagen.episode import Episode
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.export_meta import DOCUMENT, INFO, STATS, load_dataset_document
from codediffuser.datasets.exporting.pictures import masks_of_bits, picture_of
from codediffuser.datasets.exporting.source import Source
from codediffuser.datasets.exporting.video import VideoConfig
from codediffuser.datasets.features import (
    LABELS,
    PROGRAM,
    STATE,
    depth_key,
    image_key,
    intrinsics_key,
    mask_key,
    pose_key,
)
from codediffuser.datasets.stats import QUANTILES
from codediffuser.errors import DatasetError
from codediffuser.labeling.store import LABELS as LABELS_FILE

H264 = VideoConfig(codec="h264")


def export(run: Path, profile: str = "portable", **options: object) -> Path:
    for _ in convert_run(run, profile=profile, video=H264, **options):  # type: ignore[arg-type]
        pass
    return run / "exports" / f"lerobot-{profile}"


def episodes(run: Path) -> list[Episode]:
    return [Episode.open(folder) for folder in sorted((run / "episodes").iterdir())]


def data_files(root: Path) -> dict[str, bytes]:
    parts = [path for part in ("data", "meta", "videos") for path in (root / part).rglob("*")]
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in parts
        if path.is_file() and path != root / DOCUMENT
    }


def test_the_stock_loader_gives_back_what_was_recorded(
    labelled_run: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    run = labelled_run(2)
    dataset = LeRobotDataset("local/portable", root=export(run), video_backend="pyav")
    assert (len(dataset), dataset.num_episodes) == (11, 2)
    second = episodes(run)[1]
    source = Source(second.folder)
    for k in (0, 5):
        item, frame = dataset[5 + k], second.frame(k)
        for name, camera in second.cameras.items():
            picture = item[image_key(name)].numpy().transpose(1, 2, 0) * 255
            assert np.abs(picture - frame.rgb[name]).mean() < 3
            stored = np.rint(frame.depth_m[name] * 1000).astype(np.uint16)
            assert np.array_equal(picture_of(item[depth_key(name)]), stored)
            masks = masks_of_bits(picture_of(item[mask_key(name)]))
            assert np.array_equal(masks, source.masks(frame, name)) and masks.any()
            assert np.allclose(item[intrinsics_key(name)].reshape(3, 3), camera.K)
            pose = item[pose_key(name)].reshape(4, 4)
            assert np.allclose(pose, camera.T_world_camera, atol=1e-6)
        assert json.loads(item[LABELS])["episode_id"] == second.id
        assert "slot" in item[PROGRAM]


def test_stock_policies_take_colour_and_state_alone(labelled_run: Callable[..., Path]) -> None:
    from lerobot.datasets.utils import dataset_to_policy_features

    info = json.loads((export(labelled_run(1)) / INFO).read_text())
    cameras = [key for key, f in info["features"].items() if f["dtype"] == "video"]
    assert len(cameras) == 5
    assert set(dataset_to_policy_features(info["features"])) == {*cameras, STATE, "action"}


def test_masked_pictures_are_black_where_no_attention_is(
    labelled_run: Callable[..., Path],
) -> None:
    import av

    run = labelled_run(1)
    root = export(run, "masked-rgb")
    episode = episodes(run)[0]
    source, name = Source(episode.folder), episode.manifest.cameras[0].name
    video = next((root / "videos" / image_key(name)).rglob("*.mp4"))
    with av.open(str(video)) as container:
        decoded = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert len(decoded) == episode.num_frames
    attended = source.masks(episode.frame(2), name).any(axis=0)
    assert decoded[2][attended].mean() > 60 > 20 > decoded[2][~attended].mean()


def test_statistics_are_those_of_all_frames(labelled_run: Callable[..., Path]) -> None:
    run = labelled_run(2)
    stats = json.loads((export(run) / STATS).read_text())
    both = episodes(run)
    state = np.concatenate([episode.state for episode in both]).astype(np.float64)
    assert np.allclose(stats[STATE]["std"], state.std(axis=0))
    for name, share in QUANTILES.items():
        assert np.allclose(stats[STATE][name], np.quantile(state, share, axis=0)), name
    camera = both[0].manifest.cameras[0].name
    pixels = np.concatenate([f.rgb[camera].reshape(-1, 3) for e in both for f in e.frames()]) / 255
    found = stats[image_key(camera)]
    assert np.allclose(np.ravel(found["mean"]), pixels.mean(axis=0))
    assert np.shape(found["std"]) == (3, 1, 1) and found["count"] == [11]


def test_a_grown_run_takes_old_episodes_from_the_export(
    labelled_run: Callable[..., Path], tmp_path: Path
) -> None:
    run = labelled_run(2)
    whole = data_files(export(run))
    aside = tmp_path / "aside"
    shutil.move(run / "episodes" / "000001", aside)
    export(run)
    shutil.move(aside, run / "episodes" / "000001")
    again = list(convert_run(run, profile="portable", video=H264))
    assert [(p.episode_id, p.reused) for p in again] == [("000001", False), ("000002", True)]
    assert data_files(run / "exports" / "lerobot-portable") == whole


def test_other_options_encode_again(labelled_run: Callable[..., Path]) -> None:
    run = labelled_run(1)
    export(run)
    again = list(convert_run(run, profile="portable", video=VideoConfig(codec="h264", crf=40)))
    assert not any(p.reused for p in again)


def test_a_changed_export_is_no_source(labelled_run: Callable[..., Path]) -> None:
    run = labelled_run(1)
    root = export(run)
    whole = data_files(root)
    video = next((root / "videos").rglob("*.mp4"))
    video.write_bytes(video.read_bytes()[:-1] + b"x")
    assert not any(p.reused for p in convert_run(run, profile="portable", video=H264))
    assert data_files(root) == whole


def test_portable_takes_runs_without_labels(labelled_run: Callable[..., Path]) -> None:
    run = labelled_run(2)
    (run / "episodes" / "000001" / LABELS_FILE).unlink()
    with pytest.raises(DatasetError, match="1 of 2 successful episodes have no labels: 000001"):
        export(run)
    (run / "episodes" / "000002" / LABELS_FILE).unlink()
    with pytest.raises(DatasetError, match="2 of 2 successful episodes have no labels"):
        export(run, "masked-rgb")
    root = export(run)
    columns = pq.read_schema(next(root.glob("data/*/*.parquet"))).names
    assert LABELS not in columns and not [name for name in columns if "mask" in name]
    assert load_dataset_document(root).episodes[0].labels_revision == 0


def test_the_card_tells_and_shows(labelled_run: Callable[..., Path]) -> None:
    root = export(labelled_run(2))
    card = (root / "README.md").read_text()
    assert card.startswith("---\n") and "data_files: data/*/*.parquet" in card
    for fact in ("# pack_battery", "2 demonstrations", "11 frames at 25 Hz", "## Splits",
                 "Put the battery in the right slot. (1)", "| pick | battery | simulator | 2 |",
                 load_dataset_document(root).content_sha256):  # fmt: skip
        assert fact in card, fact
    for picture in ("card/first_frames.png", "card/motion.png"):
        assert f"]({picture})" in card and (root / picture).stat().st_size > 1000
