import io
from pathlib import Path

import numpy as np
import pytest

from codediffuser.datagen import drawing
from codediffuser.datagen.drawing import Arrow, Box, Cross, Disc, Drawing, Text
from codediffuser.datagen.reset_image import render_png, save_pictures
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task_config import Observer
from codediffuser.datagen.tasks.pack_battery import PackBattery


@pytest.fixture(scope="module")
def scene(scenes: list[SceneSpec]) -> SceneSpec:
    return next(s for s in scenes if s.ambiguity.picks == 3 and s.ambiguity.places == 6)


@pytest.fixture(scope="module")
def picture(scene: SceneSpec, pack_battery: PackBattery) -> Drawing:
    return pack_battery.draw_reset(scene)


def pixels(png: bytes) -> np.ndarray:
    import matplotlib.image

    return (matplotlib.image.imread(io.BytesIO(png), format="png")[..., :3] * 255).round()


def test_every_battery_is_a_disc_at_its_place_and_only_the_target_is_green(
    scene: SceneSpec, picture: Drawing
) -> None:
    batteries = {o.position_m[:2]: o.id for o in scene.objects if o.category == "battery"}
    discs = {s.center_m: s.fill for s in picture.shapes if isinstance(s, Disc) and s.fill}
    assert discs.keys() == batteries.keys()
    green = [batteries[at] for at, fill in discs.items() if fill == drawing.TARGET]
    assert green == [scene.target.pick]


def test_the_target_slot_is_green_and_an_arrow_leads_to_it(
    scene: SceneSpec, picture: Drawing
) -> None:
    slot = scene.place(scene.target.place).position_m[:2]
    (tinted,) = (s for s in picture.shapes if isinstance(s, Box) and s.fill == drawing.TARGET_TINT)
    np.testing.assert_allclose(np.mean([tinted.low_m, tinted.high_m], axis=0), slot)
    (arrow,) = (s for s in picture.shapes if isinstance(s, Arrow))
    assert np.linalg.norm(np.subtract(arrow.end_m, slot)) < 0.016


def test_crosses_stand_at_whole_multiples_on_the_pad(picture: Drawing) -> None:
    crosses = np.array([s.center_m for s in picture.shapes if isinstance(s, Cross)])
    assert len(crosses) >= 12
    np.testing.assert_allclose(crosses / 0.04, np.round(crosses / 0.04), atol=1e-9)


def test_the_drawing_says_episode_instruction_sides_and_where_the_robot_is(
    scene: SceneSpec, picture: Drawing
) -> None:
    assert picture.title == f"Episode {int(scene.scene_id)}"
    assert picture.sentence == scene.instruction.text
    (panel,) = picture.panels
    assert (panel.sides.left, panel.sides.right, panel.sides.top) == ("left", "right", "back")
    assert panel.sides.bottom.startswith("front") and "robot" in panel.sides.bottom
    assert {"3 on the pad", "6 in the crate"} <= set(picture.notes)


def test_sides_speak_as_the_instructions_do(scene: SceneSpec) -> None:
    config = PackBattery.load_config()
    observer = Observer(right=(1, 0), front=(0, 1))
    picture = PackBattery(config.model_copy(update={"observer": observer})).draw_reset(scene)
    (panel,) = picture.panels
    assert panel.sides.top == "front" and panel.sides.bottom.startswith("back")


def test_everything_is_inside_the_page(scenes: list[SceneSpec], pack_battery: PackBattery) -> None:
    for scene in scenes[:20]:
        (panel,) = pack_battery.draw_reset(scene).panels
        for shape in panel.shapes:
            points = {
                Disc: ("center_m",), Cross: ("center_m",), Box: ("low_m", "high_m"),
                Arrow: ("start_m", "end_m"), Text: ("at_m",),
            }[type(shape)]  # fmt: skip
            for name in points:
                at = np.array(getattr(shape, name))
                assert np.all(at >= panel.low_m) and np.all(at <= panel.high_m)


def test_the_same_drawing_gives_the_same_bytes(picture: Drawing, tmp_path: Path) -> None:
    first = render_png(picture)
    assert first == render_png(picture)
    save_pictures(picture, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == first
    assert picture.sentence.split()[0] in (tmp_path / "a.svg").read_text()


def test_pixels_show_the_world_with_plus_y_up_and_plus_x_right(
    scene: SceneSpec, picture: Drawing
) -> None:
    rgb = pixels(render_png(picture))
    color = [int(drawing.TARGET[i : i + 2], 16) for i in (1, 3, 5)]
    rows, columns = np.nonzero(np.all(np.abs(rgb - color) <= 2, axis=-1))
    assert len(rows) > 500
    x, y, _ = scene.object(scene.target.pick).position_m
    orange = [int(drawing.OBJECT[i : i + 2], 16) for i in (1, 3, 5)]
    others = [o for o in scene.objects if o.category == "battery" and o.id != scene.target.pick]
    all_rows, all_columns = np.nonzero(np.all(np.abs(rgb - orange) <= 2, axis=-1))
    mean_x, mean_y = np.mean([o.position_m[:2] for o in others], axis=0)
    assert np.sign(rows.mean() - all_rows.mean()) == np.sign(mean_y - y)
    assert np.sign(columns.mean() - all_columns.mean()) == np.sign(x - mean_x)


def test_a_long_sentence_makes_the_page_longer_not_narrower(picture: Drawing) -> None:
    from dataclasses import replace

    short, long = (
        pixels(render_png(replace(picture, sentence=text))).shape
        for text in ("Go.", "A very long sentence. " * 12)
    )
    assert long[0] > short[0] and long[1] == short[1]
