import re
from dataclasses import replace

import numpy as np
import pytest

from codediffuser.datagen.placement import Area, KeepOut, sample_positions
from codediffuser.errors import PlacementError

AREA = Area((-0.09, 0.07), (-0.09, 0.03), min_distance_m=0.09, max_tries=1000, max_redraws=100)


def place(count: int, area: Area = AREA, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return sample_positions(rng, count, area, keys="variants.sim", what="batteries")


@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_positions_lie_in_the_area_and_keep_their_distance(count: int) -> None:
    for seed in range(30):
        xy = place(count, seed=seed)
        assert xy.shape == (count, 2)
        assert np.all((xy >= [-0.09, -0.09]) & (xy <= [0.07, 0.03]))
        gaps = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
        assert np.all(gaps[~np.eye(count, dtype=bool)] >= 0.09)


def test_same_seed_gives_the_same_positions_and_another_seed_others() -> None:
    np.testing.assert_array_equal(place(4, seed=3), place(4, seed=3))
    assert not np.array_equal(place(4, seed=3), place(4, seed=4))


def test_positions_stay_clear_of_what_keeps_out() -> None:
    box = KeepOut("a wall", (-0.02, 0.0), (-0.2, 0.2))
    area = replace(AREA, min_distance_m=0.0, keep_out=(box,), keep_out_margin_m=0.015)
    xy = place(200, area)
    assert np.all((xy[:, 0] < -0.035) | (xy[:, 0] > 0.015))
    assert xy[:, 0].min() < -0.035 < 0.015 < xy[:, 0].max()


def test_too_large_a_distance_names_the_key_and_a_value_that_then_works() -> None:
    area = replace(AREA, min_distance_m=0.3, max_redraws=5)
    with pytest.raises(PlacementError) as caught:
        place(4, area)
    message = str(caught.value)
    assert message.startswith("cannot place 4 batteries at least 0.3 m apart in x [-0.09, 0.07]")
    assert "widen 'variants.sim.area_x_m' and 'variants.sim.area_y_m'" in message
    advice = re.search(r"lower 'variants\.sim\.min_distance_m' to ([\d.]+)", message)
    assert advice is not None
    for seed in range(20):
        assert len(place(4, replace(AREA, min_distance_m=float(advice[1])), seed)) == 4


def test_no_distance_is_suggested_at_which_things_run_into_each_other() -> None:
    area = replace(AREA, max_redraws=2, max_tries=50, keep_out_margin_m=0.015)
    with pytest.raises(PlacementError, match="ask for fewer batteries, or widen"):
        place(40, area)


def test_an_area_under_a_keep_out_is_told_to_move() -> None:
    area = replace(AREA, keep_out=(KeepOut("the crate", (-1, 1), (-1, 1)),))
    with pytest.raises(PlacementError, match=r"move 'variants\.sim\.area_x_m'.* away from it"):
        place(1, area)
