import numpy as np
import pytest

from codediffuser.seeding import Stage, int_seed, rng_for, seed_sequence


def draws(root: int, stage: Stage, index: int = 0, attempt: int = 0) -> bytes:
    return rng_for(root, stage, index, attempt).bytes(32)


def test_the_same_address_gives_the_same_numbers() -> None:
    assert draws(7, Stage.SCENE, 3, 1) == draws(7, Stage.SCENE, 3, 1)


def test_what_was_drawn_before_changes_nothing() -> None:
    expected = draws(7, Stage.SCENE, 3)
    for index in range(3):
        rng_for(7, Stage.SCENE, index).normal(size=100)
    assert draws(7, Stage.SCENE, 3) == expected


def test_every_part_of_an_address_counts() -> None:
    addresses = [
        (root, stage, index, attempt)
        for root in (0, 1)
        for stage in (Stage.SCENE, Stage.EVAL_SCENE)
        for index in (0, 1)
        for attempt in (0, 1)
    ]
    assert len({draws(*address) for address in addresses}) == len(addresses)


def test_stage_numbers_stay_as_files_have_them() -> None:
    assert {stage.name: int(stage) for stage in Stage} == {
        "SCENE": 1,
        "INSTRUCTION": 2,
        "EXPERT": 3,
        "SIMULATION": 4,
        "CLOUD": 5,
        "TRAIN": 6,
        "EVAL_SCENE": 7,
        "EVAL_POLICY": 8,
        "STRESS": 9,
        "ENV": 10,
        "APPEARANCE": 11,
        "SENSOR": 12,
        "RECOVERY": 13,
        "PERCEPTION": 14,
    }


def test_numbers_do_not_change_between_versions() -> None:
    # Scene files name their seed key; another stream here would make them lie.
    assert rng_for(42, Stage.SCENE, 7).integers(0, 1000, 4).tolist() == [982, 553, 176, 90]


def test_a_seed_key_can_be_rebuilt_from_its_numbers() -> None:
    sequence = seed_sequence(5, Stage.EXPERT, 12, 3)
    assert sequence.entropy == 5
    assert sequence.spawn_key == (int(Stage.EXPERT), 12, 3)


def test_integer_seeds_fit_31_bits() -> None:
    rng = np.random.default_rng(0)
    seeds = [int_seed(rng) for _ in range(1000)]
    assert all(type(seed) is int and 0 <= seed < 2**31 - 1 for seed in seeds)
    assert max(seeds) > 2**30


@pytest.mark.parametrize("address", [(-1, 0, 0), (0, -1, 0), (0, 0, -1)])
def test_a_negative_part_is_refused(address: tuple[int, int, int]) -> None:
    root, index, attempt = address
    with pytest.raises(ValueError):
        rng_for(root, Stage.SCENE, index, attempt)
