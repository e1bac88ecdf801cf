"""Makes the pictures of the manual: `python -m codediffuser.labeling.gui.screenshots RUN OUT`."""

from __future__ import annotations

import io
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import tyro
from PIL import Image

from codediffuser.labeling.gui.app import LabelApp
from codediffuser.labeling.gui.bench import operator_view, true_targets, unlabeled_copy
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.scripted import ScriptedOperator, open_browser

SETTLE_S = 3.0
"""Software rendering needs so long until nothing changes any more."""

JPEG_QUALITY = 82


def take(
    run: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path], *, settle_s: float = SETTLE_S
) -> Iterator[Path]:
    """Label the first episode of a run and photograph it: as it opens, and in its other views.

    Args:
        run: Run with simulated episodes; it is copied.
        out: Folder for `labeling_<task>[_camera|_3d].jpg`.
        settle_s: How long to wait before each picture.

    Yields:
        Each picture's path once it is there.

    Raises:
        SetupError: Playwright or Chromium is missing.
    """
    with tempfile.TemporaryDirectory() as scratch, open_browser() as context:
        desk = Desk(unlabeled_copy(run, Path(scratch), 2))
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
            path = out / f"labeling_{task}{suffix}.jpg"
            shot = Image.open(io.BytesIO(operator.screenshot())).convert("RGB")
            shot.save(path, quality=JPEG_QUALITY, optimize=True)
            yield path
        app.close()


def main() -> None:
    """Print the path of each picture."""
    for path in tyro.cli(take):
        sys.stdout.write(f"{path}\n")


if __name__ == "__main__":
    main()
