"""Makes the pictures of the manual: `python -m codediffuser.labeling.gui.screenshots RUN OUT`."""

from __future__ import annotations

import io
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from codediffuser.labeling.gui.app import LabelApp
from codediffuser.labeling.gui.bench import operator_view, true_targets, unlabeled_copy
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.reference_book import ReferenceBook
from codediffuser.labeling.gui.scripted import ScriptedOperator, open_browser
from codediffuser.labeling.perception.references import BACKGROUND

SETTLE_S = 3.0
"""Software rendering needs so long until nothing changes any more."""

JPEG_QUALITY = 82


def take(
    run: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path], *, settle_s: float = SETTLE_S
) -> Iterator[Path]:
    """Label the first episode of a run and photograph it: each view, and reference mode.

    Args:
        run: Run with simulated episodes; it is copied.
        out: Folder for `labeling_<task>[_camera|_3d|_references].jpg`.
        settle_s: How long to wait before each picture.

    Yields:
        Each picture's path once it is there.

    Raises:
        SetupError: Playwright or Chromium is missing.
    """
    with tempfile.TemporaryDirectory() as scratch, open_browser() as context:
        copy = unlabeled_copy(run, Path(scratch), 2)
        desk = Desk(copy, references=ReferenceBook("oracle", copy / "references.json"))
        app = LabelApp(desk, operator="ada", port=0)
        operator = ScriptedOperator(context, app.url)
        scene = desk.scene(operator.episode())
        view, (pick, place) = operator_view(scene), true_targets(scene)
        operator.click(operator.spot(scene, pick, view))
        operator.wait_for_chosen(pick)
        operator.click(operator.spot(scene, place, view))
        operator.wait_for_chosen(pick, place)
        others = [i.id for i in scene.instances if i.role == "pick" and i.id != pick]
        operator.hover(operator.spot(scene, (others or [pick])[0], view))
        task = scene.task.name if scene.task else "run"
        for suffix, key in (("", None), ("_camera", "c"), ("_3d", "v")):
            if key == "c" and view != "top":
                continue
            if key is not None:
                operator.press(key)
            time.sleep(settle_s)
            yield _photograph(operator, out / f"labeling_{task}{suffix}.jpg")
        _collect_references(operator, scene, pick)
        time.sleep(settle_s)
        yield _photograph(operator, out / f"labeling_{task}_references.jpg")
        app.close()


def _photograph(operator: ScriptedOperator, path: Path) -> Path:
    shot = Image.open(io.BytesIO(operator.screenshot())).convert("RGB")
    shot.save(path, quality=JPEG_QUALITY, optimize=True)
    return path


def _collect_references(operator: ScriptedOperator, scene: EpisodeScene, pick: str) -> None:
    """Click the object, then background beside it, in reference mode."""
    camera = next(iter(scene.cameras))
    categories = [*(need.category for need in scene.needs), BACKGROUND]
    operator.press("i")
    operator.wait_for_references(**dict.fromkeys(categories, 0))
    photo = scene.through(camera)
    shown = photo.points[photo.owner == [i.id for i in scene.instances].index(pick)]
    for aim in (shown[len(shown) // 3], shown[2 * len(shown) // 3]):
        operator.click(operator.place(scene, aim, camera))
    operator.wait_for_references(**{**dict.fromkeys(categories, 0), categories[0]: 2})
    operator.press("z")
    operator.press("z")
    beside = shown.max(axis=0) + np.array([0.06 * scene.cameras[camera].width, 0])
    operator.click(operator.place(scene, beside, camera))
    operator.wait_for_references(
        **{**dict.fromkeys(categories, 0), categories[0]: 2, BACKGROUND: 1}
    )


def main() -> None:
    """Print the path of each picture."""
    for path in tyro.cli(take):
        sys.stdout.write(f"{path}\n")


if __name__ == "__main__":
    main()
