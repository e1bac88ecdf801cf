"""`sample` beside sampling: photos checked, episodes overlaid, one thing asked for at a time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codediffuser import cli
from codediffuser.datagen.scene import SceneSpec


def test_one_thing_is_asked_for_at_a_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for words in ([], ["pack_battery", "--overlay-episodes", str(tmp_path)]):
        assert cli.run(["sample", *words]) == 2
        assert "expected one of TASK, --check-photo" in " ".join(capsys.readouterr().err.split())


def test_sampling_needs_a_folder(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["sample", "pack_battery"]) == 2
    assert "expected --out FOLDER" in capsys.readouterr().err


def test_a_photo_without_tags_is_one_line_and_leaves_no_picture(
    small_scene: SceneSpec, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo, scene = tmp_path / "photo.png", tmp_path / "scene.yaml"
    Image.fromarray(np.full((240, 320, 3), 200, dtype=np.uint8)).save(photo)
    small_scene.save(scene)
    assert cli.run(["sample", "--check-photo", str(photo), str(scene)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "photo.png: expected the tags beside the pad of pack_battery sim, found none" in said
    assert not (tmp_path / "photo_check.png").exists()


def test_episodes_are_overlaid_into_their_run_or_elsewhere(
    tmp_path: Path, write_synthetic_episode: Callable[..., Any]
) -> None:
    run = tmp_path / "run"
    write_synthetic_episode(run)
    assert cli.run(["sample", "--overlay-episodes", str(run)]) == 0
    assert (run / "overlay_left.png").is_file() and (run / "overlay_right.png").is_file()
    elsewhere = tmp_path / "pictures"
    assert cli.run(["sample", "--overlay-episodes", str(run), "--out", str(elsewhere)]) == 0
    assert (elsewhere / "overlay_left.png").is_file()
