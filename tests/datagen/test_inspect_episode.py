"""`inspect` shows an episode as it is, and says what it cannot look at."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codediffuser.cli import run as run_command
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.inspect_episode import (
    DEPTH_M,
    TILE_WIDTH,
    color_depth,
    contact_sheet,
    inspect_episode,
)
from codediffuser.errors import EpisodeError


@pytest.fixture
def folder(tmp_path: Path, write_battery_episode: Callable[..., Path]) -> Path:
    return write_battery_episode(tmp_path, num_steps=12)


def test_sheet_curves_and_film_are_written(folder: Path, tmp_path: Path) -> None:
    import av

    paths = list(inspect_episode(folder, tmp_path / "out"))
    assert [p.name for p in paths] == ["sheet.png", "motion.png", "video.mp4"]
    for path in paths[:2]:
        assert np.asarray(Image.open(path).convert("L")).std() > 5
    with av.open(str(paths[2])) as film:
        assert sum(1 for _ in film.decode(video=0)) == 12
        assert float(film.streams.video[0].average_rate) == 25


def test_the_sheet_has_a_column_a_moment_and_two_rows_a_camera(folder: Path) -> None:
    episode = Episode.open(folder)
    four = contact_sheet(episode, columns=4)
    assert four.width == 4 * TILE_WIDTH
    assert contact_sheet(episode, columns=40).width == 12 * TILE_WIDTH, "no moment twice"
    height = sum(
        2 * (round(TILE_WIDTH * c.height / c.width) + 22) for c in episode.manifest.cameras
    )
    assert height < four.height < height + 100


def test_depth_is_red_when_near_blue_when_far_and_black_without_reading() -> None:
    near, far = DEPTH_M
    (colors,) = color_depth(np.array([[near, far, 0.0]], dtype=np.float32))
    assert colors[0].argmax() == 0 and colors[1].argmax() == 2
    assert colors[2].tolist() == [0, 0, 0]


def test_the_command_writes_beside_the_episodes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["inspect", str(folder)]) == 0
    out = Path(capsys.readouterr().out.strip())
    assert out == tmp_path / "inspect" / folder.name
    assert sorted(p.name for p in out.iterdir()) == ["motion.png", "sheet.png", "video.mp4"]


def test_what_is_no_episode_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["inspect", str(tmp_path)]) == 2
    assert "nothing here that can be looked at; expected: episode" in capsys.readouterr().err


def test_a_damaged_episode_is_refused(folder: Path, tmp_path: Path) -> None:
    (folder / "episode.mcap").write_bytes(b"")
    with pytest.raises(EpisodeError, match=r"expected .* bytes, found 0"):
        list(inspect_episode(folder, tmp_path / "out"))
