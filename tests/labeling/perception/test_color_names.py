from __future__ import annotations

import numpy as np
import pytest

from codediffuser.datagen.task import get_task
from codediffuser.labeling.perception.color_names import color_name


def shaded(linear_rgb: tuple[float, float, float]) -> np.ndarray:
    """Pixels of a body of that colour, from shadow to light."""
    light = np.linspace(0.5, 1.2, 50)[:, None]
    srgb = np.clip(light * np.array(linear_rgb), 0, 1) ** (1 / 2.2)
    return (255 * srgb).astype(np.uint8)


@pytest.mark.parametrize("task, section", [("hang_mug", "mug"), ("pack_battery", "battery")])
def test_colours_of_the_tasks_are_called_what_their_yaml_calls_them(
    task: str, section: str
) -> None:
    colors = getattr(get_task(task).config, section).colors
    assert {name: color_name(shaded(rgb)) for name, rgb in colors.items()} == {
        name: name for name in colors
    }


def test_most_pixels_decide_and_paper_counts_less() -> None:
    red, white = shaded((0.6, 0.05, 0.05)), np.full((100, 3), 240, np.uint8)
    assert color_name(np.concatenate([red, white])) == "red"
    assert color_name(white) == "white"
