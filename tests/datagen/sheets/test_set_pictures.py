from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pypdfium2
import pytest
from PIL import Image

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen import drawing
from codediffuser.datagen.drawing import Drawing, Panel
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene_files import sample_scenes
from codediffuser.datagen.scene_sampler import SceneSource
from codediffuser.datagen.sheets.contact_sheet import AT_LEAST, contact_sheet, grid
from codediffuser.datagen.sheets.episode_overlay import overlay_episodes
from codediffuser.datagen.sheets.layout import lay_out
from codediffuser.datagen.sheets.overlay import overlay_png
from codediffuser.datagen.task import TASKS
from codediffuser.errors import ConfigError, EpisodeError


def pixels(png: bytes) -> np.ndarray:
    return np.array(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def one_disc(x: float) -> Drawing:
    fixed = drawing.Box((0, 0), (1, 0.2), fill="#808080")
    disc = drawing.Disc((x, 0.6), 0.1, "#ff0000", "#ff0000")
    words = drawing.Text((x, 0.6), "take", 9)
    return Drawing("Episode 0", (), "Go.", (Panel((0, 0), (1, 1), (fixed, disc, words)),))


@pytest.mark.parametrize("variant", ["sim", "real"])
@pytest.mark.parametrize("name", TASKS.names())
def test_a_set_has_pictures_of_every_scene_and_of_all(
    name: str, variant: str, tmp_path: Path
) -> None:
    source = SceneSource(TASKS.get(name)(), SamplingSettings(root_seed=3, variant=variant))
    list(sample_scenes(source, tmp_path, 3, paper="A3"))
    for i in range(3):
        assert {".yaml", ".png", ".svg"} == {p.suffix for p in tmp_path.glob(f"{i:06d}.*")}
    assert {"overlay.png", "sheet.pdf", "pads.pdf"} <= {p.name for p in tmp_path.iterdir()}
    text = pypdfium2.PdfDocument(tmp_path / "sheet.pdf")[0].get_textpage().get_text_range()
    assert "Episode 0" in text and "Episode 2" in text and f"{name} · {variant}" in text


def test_the_sheet_numbers_its_pages_and_shows_every_picture_once(drawings: list[Drawing]) -> None:
    document = pypdfium2.PdfDocument(contact_sheet(drawings, "twenty"))
    texts = [page.get_textpage().get_text_range() for page in document]
    assert all(f"page {i + 1} of {len(texts)}" in text for i, text in enumerate(texts))
    titles = [line for text in texts for line in text.splitlines() if line.startswith("Episode ")]
    assert [t.split(" pack")[0] for t in titles] == [d.title for d in drawings]


@pytest.mark.parametrize("size", [(432, 700), (792, 350), (432, 432), (100, 100)])
def test_pictures_on_a_sheet_neither_leave_it_nor_overlap(size: tuple[float, float]) -> None:
    columns, rows, scale = grid(*size)
    assert columns * rows >= AT_LEAST and 0.2 < scale <= 1
    assert columns * scale * size[0] < 210 / 25.4 * 72
    assert rows * scale * size[1] < 297 / 25.4 * 72


def test_the_overlay_shows_what_is_common_once_and_what_differs_by_how_often() -> None:
    often, rare = 0.25, 0.75
    drawings = [one_disc(often)] * 9 + [one_disc(rare)]
    rgb = pixels(overlay_png(drawings, ("task",)))
    placed = lay_out(one_disc(often))

    def at(x: float, y: float) -> np.ndarray:
        panel = 432 - 60
        column = (30 + x * panel) * 110 / 72
        return rgb[round(rgb.shape[0] - (30 + y * panel) * 110 / 72), round(column)]

    assert placed.width == 432
    assert at(0.5, 0.1).tolist() == [128, 128, 128]
    assert at(0.5, 0.6).tolist() == [255, 255, 255]
    dense, faint = at(often, 0.6), at(rare, 0.6)
    assert dense[0] == faint[0] == 255
    assert dense[1] < faint[1] < 220


def test_the_overlay_is_the_same_in_any_order_and_every_time(drawings: list[Drawing]) -> None:
    first = overlay_png(drawings[:6], ("task",))
    assert first == overlay_png(drawings[:6], ("task",))
    np.testing.assert_array_equal(pixels(first), pixels(overlay_png(drawings[5::-1], ("task",))))


def test_an_overlay_of_one_scene_shows_it_and_of_none_is_refused() -> None:
    assert pixels(overlay_png([one_disc(0.5)], ())).shape[1] == 660
    with pytest.raises(ConfigError, match="at least one scene"):
        overlay_png([], ())
    two = replace(one_disc(0.5), panels=one_disc(0.5).panels * 2)
    with pytest.raises(ConfigError, match="several kinds"):
        overlay_png([one_disc(0.5), two], ())


def test_first_pictures_of_episodes_are_averaged_camera_by_camera(
    tmp_path: Path, write_synthetic_episode: Callable[..., Any]
) -> None:
    for name in ("000001", "000002"):
        _, _, pictures = write_synthetic_episode(tmp_path, name)
    paths = list(overlay_episodes(tmp_path))
    assert [p.name for p in paths] == ["overlay_left.png", "overlay_right.png"]
    mean = np.array(Image.open(paths[0])).astype(int)
    assert np.abs(mean - pictures[0].rgb["left"].astype(int)).mean() < 4


def test_an_overlay_of_no_episodes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="no episodes here"):
        list(overlay_episodes(tmp_path))
