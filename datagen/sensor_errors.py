"""Makes ideal pictures as poor as those of a real depth camera, from an episode's own address."""

from __future__ import annotations

import numpy as np

from codediffuser.datagen.appearance import SensorErrors
from codediffuser.datagen.scene import SeedKey
from codediffuser.seeding import Stage, seed_sequence

EDGE_M = 0.02
"""A jump in depth from one pixel to the next that makes an edge."""


def sensor_rng(seed: SeedKey, frame: int, camera: int) -> np.random.Generator:
    """Generator of one picture: neither frames nor cameras share numbers.

    Args:
        seed: Of the scene.
        frame: Number of the frame.
        camera: Number of the camera.
    """
    sequence = seed_sequence(seed.root, Stage.SENSOR, seed.index, frame)
    return np.random.default_rng(
        np.random.SeedSequence(sequence.entropy, spawn_key=(*sequence.spawn_key, camera))
    )


def spoil_color(rgb: np.ndarray, errors: SensorErrors, rng: np.random.Generator) -> np.ndarray:
    """Noise and gain on a picture (H, W, 3) uint8; a new array."""
    if errors.color_noise == 0 and errors.color_gain == (1.0, 1.0, 1.0):
        return rgb
    noise = rng.standard_normal(rgb.shape, dtype=np.float32) * np.float32(errors.color_noise)
    spoiled = rgb * np.array(errors.color_gain, dtype=np.float32) + noise
    return np.clip(np.rint(spoiled), 0, 255).astype(np.uint8)


def spoil_depth(depth_m: np.ndarray, errors: SensorErrors, rng: np.random.Generator) -> np.ndarray:
    """Noise and missing readings on depth (H, W) float32 metres, 0 for no reading; a new array.

    Noise grows with the square of the distance, as for stereo and structured light: an error in
    disparity is one in 1/z. Source: Khoshelham and Elberink, Accuracy and resolution of Kinect
    depth data, Sensors 12, 2012.
    """
    sigma = np.float32(errors.depth_base_m) + np.float32(errors.depth_per_m) * depth_m**2
    noisy = depth_m + sigma * rng.standard_normal(depth_m.shape, dtype=np.float32)
    chance = np.where(depth_edges(depth_m), errors.edge_drop_probability, errors.drop_probability)
    missing = rng.random(depth_m.shape) < chance
    missing |= _holes(depth_m.shape, errors, rng)
    return np.where(missing | (depth_m == 0), 0, np.maximum(noisy, 0)).astype(np.float32)


def depth_edges(depth_m: np.ndarray) -> np.ndarray:
    """Pixels (H, W) bool beside a jump in depth."""
    edges = np.zeros(depth_m.shape, dtype=bool)
    across = np.abs(np.diff(depth_m, axis=1)) > EDGE_M
    down = np.abs(np.diff(depth_m, axis=0)) > EDGE_M
    edges[:, 1:] |= across
    edges[:, :-1] |= across
    edges[1:] |= down
    edges[:-1] |= down
    return edges


def _holes(shape: tuple[int, ...], errors: SensorErrors, rng: np.random.Generator) -> np.ndarray:
    """Round regions (H, W) bool at random places."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    inside = np.zeros(shape, dtype=bool)
    radius = errors.hole_radius * shape[0]
    for row, column in rng.uniform(size=(errors.holes, 2)) * shape:
        inside |= (rows - row) ** 2 + (columns - column) ** 2 <= radius**2
    return inside
