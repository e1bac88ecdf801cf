"""One episode as an HDF5 file, streamed frame by frame: the part of formats that hold arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen import ros_messages as ros
from codediffuser.datagen.episode import Episode, Frame
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.episode_clouds import episode_columns
from codediffuser.datasets.exporting.format import ExportOptions
from codediffuser.datasets.exporting.pictures import mask_bits
from codediffuser.datasets.exporting.source import Source
from codediffuser.datasets.features import POINT_CHANNELS
from codediffuser.errors import EpisodeError

PART = "episode.h5"
CLOUD_CHANNELS = len(POINT_CHANNELS)


@dataclass(frozen=True, slots=True)
class PicturePaths:
    """Names of the picture arrays, with `{camera}` in them; None leaves a kind out."""

    rgb: str
    depth: str | None = None
    mask: str | None = None
    channel_axis: bool = False
    """Whether depth and masks are (T, H, W, 1), as colour is (T, H, W, 3)."""


def write_pictures(
    file: Any, source: Source, options: ExportOptions, paths: PicturePaths, labelled: bool
) -> None:
    """Stream pictures of all cameras into an open file.

    Colour is (T, H, W, 3) uint8, depth (T, H, W) uint16 in millimetres, masks (T, H, W) uint8 with
    1 for pick, 2 for place, 3 for both. With the profile `masked-rgb` colour is black where no
    attention is, and there is nothing else.
    """
    masked = options.profile == "masked-rgb"
    jobs: list[tuple[Any, Callable[[Frame], np.ndarray]]] = []
    length = source.episode.num_frames
    for camera in source.cameras:
        if masked and not camera.calibrated:
            continue
        size = (camera.height, camera.width)
        name = camera.name
        rgb = _dataset(file, paths.rgb.format(camera=name), length, (*size, 3), np.uint8)
        jobs.append((rgb, _masked_rgb(source, name) if masked else _rgb(name)))
        if masked:
            continue
        flat = (*size, 1) if paths.channel_axis else size
        if camera.depth and paths.depth is not None:
            depth = _dataset(file, paths.depth.format(camera=name), length, flat, np.uint16)
            jobs.append((depth, _depth(name, flat)))
        if camera.calibrated and labelled and paths.mask is not None:
            mask = _dataset(file, paths.mask.format(camera=name), length, flat, np.uint8)
            jobs.append((mask, _mask(source, name, flat)))
    for frame in source.episode.frames():
        for array, picture in jobs:
            array[frame.index] = picture(frame)


def write_cloud(file: Any, path: str, source: Source, config: CloudConfig) -> None:
    """Write the clouds of an episode, (T, N, 5) float32, see `features.POINT_CHANNELS`."""
    points = episode_columns(source.folder, config).points
    shape = (len(points), config.num_points, CLOUD_CHANNELS)
    make_groups(file, path)
    file.create_dataset(path, data=points.reshape(shape), chunks=(1, *shape[1:]))


def joint_states(episode: Episode) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names, positions (T, n) and velocities (T, n) of the joints, float64, rad or m.

    Raises:
        EpisodeError: The log holds none.
    """
    positions, velocities = [], []
    names: tuple[str, ...] = ()
    with episode.log_path.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=[fmt.JOINT_STATES]):
            names, position, velocity = ros.decode_joint_state(message.data)
            positions.append(position)
            velocities.append(velocity if len(velocity) else np.zeros_like(position))
    if len(positions) != episode.num_frames:
        raise EpisodeError(
            f"{episode.log_path}: expected {episode.num_frames} messages of {fmt.JOINT_STATES}, "
            f"got {len(positions)}; {episode.remedy}"
        )
    return names, np.array(positions), np.array(velocities)


def copy_group(source: Any, target: Any, attributes: Mapping[str, Any] | None = None) -> None:
    """Copy all of a group into another file, and set attributes there."""
    for name in source:
        source.copy(source[name], target, name)
    for name, value in {**dict(source.attrs), **(attributes or {})}.items():
        target.attrs[name] = value


def open_part(folder: Path, mode: str = "r") -> Any:
    """The file of a part, as a context manager; the same data gives the same bytes."""
    import h5py

    return h5py.File(folder / PART, mode, libver="latest")


def put(file: Any, path: str, values: np.ndarray) -> None:
    """Write an array at a path of a part."""
    make_groups(file, path)
    file[path] = values


def make_groups(file: Any, path: str) -> None:
    """Create the groups above a path one by one: those that HDF5 makes on the way note the time."""
    group = file
    for name in path.split("/")[:-1]:
        group = group.require_group(name)


def _dataset(file: Any, path: str, length: int, shape: tuple[int, ...], dtype: type) -> Any:
    make_groups(file, path)
    return file.create_dataset(
        path, (length, *shape), dtype, chunks=(1, *shape), compression="gzip", compression_opts=1
    )


def _rgb(camera: str) -> Callable[[Frame], np.ndarray]:
    return lambda frame: frame.rgb[camera]


def _masked_rgb(source: Source, camera: str) -> Callable[[Frame], np.ndarray]:
    def picture(frame: Frame) -> np.ndarray:
        attended = np.asarray(source.masks(frame, camera).any(axis=0))
        return np.asarray(frame.rgb[camera] * attended[..., None])

    return picture


def _depth(camera: str, shape: tuple[int, ...]) -> Callable[[Frame], np.ndarray]:
    return lambda frame: frame.depth_mm[camera].reshape(shape)


def _mask(source: Source, camera: str, shape: tuple[int, ...]) -> Callable[[Frame], np.ndarray]:
    return lambda frame: mask_bits(source.masks(frame, camera)).reshape(shape)
