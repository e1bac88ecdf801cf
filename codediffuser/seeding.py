"""Random generators by address: the same address gives the same numbers, whatever ran before.

A generator belongs to (root seed, stage, index, attempt). Worker count, order and earlier
failures therefore change nothing, and scenes for evaluation can never meet scenes for collection.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stage(IntEnum):
    """First part of the address. Numbers are written into files: never reuse or reorder them."""

    SCENE = 1
    INSTRUCTION = 2
    EXPERT = 3
    SIMULATION = 4
    CLOUD = 5
    TRAIN = 6
    EVAL_SCENE = 7
    EVAL_POLICY = 8
    STRESS = 9
    ENV = 10
    APPEARANCE = 11
    SENSOR = 12
    RECOVERY = 13
    PERCEPTION = 14


def seed_sequence(
    root_seed: int, stage: Stage, index: int = 0, attempt: int = 0
) -> np.random.SeedSequence:
    """Return the seed sequence of one address."""
    return np.random.SeedSequence(root_seed, spawn_key=(int(stage), index, attempt))


def rng_for(root_seed: int, stage: Stage, index: int = 0, attempt: int = 0) -> np.random.Generator:
    """Return the generator of one address.

    Args:
        root_seed: Seed of the whole run, >= 0.
        stage: What the numbers are for.
        index: Which scene or episode, >= 0.
        attempt: Which try at it, >= 0.
    """
    return np.random.default_rng(seed_sequence(root_seed, stage, index, attempt))


def int_seed(rng: np.random.Generator) -> int:
    """Draw a 31-bit seed for libraries that take an integer (SAPIEN, torch)."""
    return int(rng.integers(0, 2**31 - 1))
