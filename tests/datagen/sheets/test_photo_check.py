"""Photos are made from the raster of pads.pdf, so the whole way from print to picture is tested."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import codediffuser.datagen.tasks  # noqa: F401  fills the registry
from codediffuser.datagen import drawing
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.sheets.photo_check import (
    MAX_RESIDUAL_MM,
    check_photo,
    detect_tags,
    find_pads,
    locate,
)
from codediffuser.datagen.sheets.photo_overlay import draw_over, project
from codediffuser.datagen.sheets.tags import pad_sheets
from codediffuser.datagen.task import TASKS, Pad, get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import CodeDiffuserError, ConfigError

Photo = tuple[np.ndarray, np.ndarray]
Photograph = Callable[..., Photo]

OTHER_PADS = [
    pad
    for pad in itertools.product(TASKS.names(), ("sim", "real"))
    if pad != ("pack_battery", "sim")
]
CONDITIONS: dict[str, dict[str, Any]] = {
    "phone": {"width": 1440, "height": 1080},
    "webcam": {"width": 640, "height": 480, "blur_px": 0.7, "noise": 6, "light": (0.9, 0.4)},
    "steep": {
        "width": 1280, "height": 720, "blur_px": 1.2,
        "corners": ((0.05, 0.95), (0.95, 0.9), (0.7, 0.45), (0.3, 0.45)),
    },
    "dark": {"blur_px": 1.5, "noise": 8, "light": (0.3, 0.15)},
    "upside down": {"corners": ((0.9, 0.1), (0.1, 0.15), (0.25, 0.85), (0.8, 0.75))},
}  # fmt: skip


def save(rgb: np.ndarray, path: Path) -> Path:
    from PIL import Image

    Image.fromarray(rgb).save(path, quality=90)
    return path


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_cross_is_found_within_a_millimetre(
    pack_battery: PackBattery, battery_print: Any, photograph: Photograph, name: str
) -> None:
    rgb, H_true = photograph(battery_print, **CONDITIONS[name])
    (view,) = find_pads(rgb, pack_battery, "sim")
    crosses = np.array(battery_print.sheet.pad.crosses_m())
    estimated = project(np.linalg.inv(view.H_image_world), project(H_true, crosses))
    assert np.linalg.norm(estimated - crosses, axis=1).max() < 0.001
    assert view.residual_mm < 0.5 and len(view.corners_seen) == 4


@pytest.mark.parametrize("hidden", range(4))
def test_one_hidden_tag_does_no_harm_and_two_are_refused(
    battery_print: Any, battery_photo: Photo, hidden: int
) -> None:
    rgb, H_true = battery_photo
    seen, sheet = detect_tags(rgb), battery_print.sheet
    del seen[sheet.tags[hidden].number]
    view = locate(sheet, seen)
    crosses = np.array(sheet.pad.crosses_m())
    estimated = project(np.linalg.inv(view.H_image_world), project(H_true, crosses))
    assert np.linalg.norm(estimated - crosses, axis=1).max() < 0.001
    del seen[sheet.tags[(hidden + 1) % 4].number]
    with pytest.raises(ConfigError, match=r"at least 3 of the 4 tags .* found 2; not seen:"):
        locate(sheet, seen)


def test_a_photo_without_tags_is_refused_and_says_what_to_look_for(
    pack_battery: PackBattery,
) -> None:
    empty = np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8)
    with pytest.raises(ConfigError, match=r"found none; is the sheet from pads\.pdf in the photo"):
        find_pads(empty, pack_battery, "sim")


def test_a_mirrored_photo_is_named_as_such(pack_battery: PackBattery, battery_photo: Photo) -> None:
    rgb, _ = battery_photo
    with pytest.raises(ConfigError, match="mirrored"):
        find_pads(np.ascontiguousarray(rgb[:, ::-1]), pack_battery, "sim")


@pytest.mark.parametrize(("name", "variant"), OTHER_PADS)
def test_the_pad_of_another_task_or_variant_is_named(
    battery_photo: Photo, name: str, variant: str
) -> None:
    rgb, _ = battery_photo
    with pytest.raises(ConfigError, match=rf"pad of {name} {variant}, found .*pack_battery · sim"):
        find_pads(rgb, get_task(name), variant)


def test_a_pad_printed_before_the_yaml_changed_is_another_pad(
    battery_photo: Photo, printed: Any, photograph: Photograph, pack_battery: PackBattery
) -> None:
    picture = pack_battery.config.reset_image.model_copy(update={"cross_spacing_m": 0.03})
    other = PackBattery(pack_battery.config.model_copy(update={"reset_image": picture}))
    with pytest.raises(ConfigError, match="found that of pack_battery · sim"):
        find_pads(battery_photo[0], other, "sim")
    old, _ = photograph(printed(other, "sim"))
    with pytest.raises(ConfigError, match=r"of a pad that no task has; .* Print pads"):
        find_pads(old, pack_battery, "sim")


def test_tiles_joined_wrongly_are_refused_with_the_residual(battery_print: Any) -> None:
    sheet, H = battery_print.sheet, battery_print.H_print_world
    off = {
        tag.number: project(H, tag.corners_m() + np.array([0.012 * (corner in (1, 2)), 0]))
        for corner, tag in enumerate(sheet.tags)
    }
    with pytest.raises(ConfigError, match=rf"within {MAX_RESIDUAL_MM} mm, got .*cut marks"):
        locate(sheet, off)


def test_the_configuration_is_drawn_where_it_should_lie(
    scenes: list[SceneSpec], battery_photo: Photo, tmp_path: Path
) -> None:
    scene = scenes[0]
    rgb, H_true = battery_photo
    photo, path = save(rgb, tmp_path / "photo.jpg"), tmp_path / "000000.yaml"
    scene.save(path)
    check = check_photo(photo, path, tmp_path / "check.png")
    assert "4 of 4 tags" in check.note and (tmp_path / "check.png").exists()
    target = np.array([scene.object(scene.target.pick).position_m[:2]])
    ring = target + 0.015 * np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    edge = np.array([int(drawing.TARGET_EDGE[i : i + 2], 16) for i in (1, 3, 5)])
    for column, row in np.round(project(H_true, ring)).astype(int):
        around = check.image_rgb[row - 2 : row + 3, column - 2 : column + 3].reshape(-1, 3)
        assert np.abs(around.astype(int) - edge).max(axis=1).min() < 25


def test_with_two_pads_in_the_photo_each_shape_goes_by_its_own() -> None:
    pads = [Pad("left", (0, 0), (0.1, 0.1), 0.05), Pad("right", (0.3, 0), (0.4, 0.1), 0.05)]
    one, two = (np.array([[500.0, 0, dx], [0, 500, 50], [0, 0, 1]]) for dx in (20.0, 60.0))
    blank = np.full((200, 400, 3), 255, dtype=np.uint8)
    shapes = [drawing.Disc((x, 0.05), 0.02, "#ff0000", "#ff0000") for x in (0.05, 0.35)]
    red = draw_over(blank, shapes, list(zip(pads, (one, two), strict=True)))[..., 1] < 200
    assert red[75, 45] and red[75, 235] and not red[75, 195]


def test_two_pads_of_a_task_have_their_own_tags() -> None:
    pads = [Pad(name, (x, 0), (x + 0.2, 0.2), 0.05) for name, x in (("mugs", 0.0), ("books", 0.4))]
    first, second = pad_sheets("some_task", "real", pads)
    assert {t.number for t in first.tags}.isdisjoint(t.number for t in second.tags)


@pytest.mark.parametrize(
    ("content", "message"), [(None, "no such photo"), (b"no picture", "expected a picture")]
)
def test_what_is_no_photo_is_refused(
    scenes: list[SceneSpec], tmp_path: Path, content: bytes | None, message: str
) -> None:
    scenes[0].save(tmp_path / "scene.yaml")
    if content is not None:
        (tmp_path / "photo.jpg").write_bytes(content)
    with pytest.raises(CodeDiffuserError, match=message):
        check_photo(tmp_path / "photo.jpg", tmp_path / "scene.yaml", tmp_path / "out.png")
