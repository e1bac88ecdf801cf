"""What the profiles of a LeRobot export make of one episode: columns, statistics, videos."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode import Frame
from codediffuser.datagen.episode_format import CameraRecord
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.episode_clouds import episode_columns
from codediffuser.datasets.exporting.columns import Column, PartStats, arrow_table, write_columns
from codediffuser.datasets.exporting.pictures import (
    PixelStats,
    mask_bits,
    png_text,
)
from codediffuser.datasets.exporting.source import Source, labels_json, program_text
from codediffuser.datasets.exporting.video import VideoConfig, VideoEncoder
from codediffuser.datasets.features import (
    ACTION,
    EPISODE_ID,
    LABELS,
    POINT_CHANNELS,
    POINTS,
    PROGRAM,
    STATE,
    Feature,
    VideoFeature,
    depth_key,
    image_key,
    intrinsics_key,
    mask_key,
    pose_key,
)
from codediffuser.datasets.stats import Histogram, feature_stats

COLUMNS = "columns.parquet"
STATS = "stats.npz"
Features = Mapping[str, Feature | VideoFeature]


def video_file(key: str) -> str:
    """File of a video feature in a part."""
    return f"{key}.mp4"


def make_pointcloud(source: Source, folder: Path, features: Features, cloud: CloudConfig) -> None:
    """Write clouds with attention, state and action of one episode."""
    made = episode_columns(source.folder, cloud)
    per_point = made.points.reshape(-1, len(POINT_CHANNELS))
    stats = PartStats(
        stats={POINTS: feature_stats(per_point, count=len(made.state))},
        histograms={POINTS: [Histogram.of(channel) for channel in per_point.T]},
    )
    columns: dict[str, Column] = {POINTS: made.points, STATE: made.state, ACTION: made.action}
    _finish(source, folder, features, columns, stats)


def make_portable(
    source: Source, folder: Path, features: Features, video: VideoConfig, labelled: bool
) -> None:
    """Write every picture of one episode: colour as video, depth and masks as text."""
    names = [camera.name for camera in source.cameras]
    texts: dict[str, list[str]] = {key(n): [] for n in names for key in (depth_key, mask_key)}

    def picture(frame: Frame, camera: CameraRecord) -> np.ndarray:
        name = camera.name
        if camera.depth:
            texts[depth_key(name)].append(png_text(frame.depth_mm[name]))
        if camera.calibrated and labelled:
            texts[mask_key(name)].append(png_text(mask_bits(source.masks(frame, name))))
        return frame.rgb[name]

    stats = _encode_videos(source, folder, features, video, picture)
    columns: dict[str, Column] = {**_motion(source), **texts}
    for camera in source.cameras:
        if camera.calibrated:
            calibration = _calibration(source, camera.name)
            columns |= calibration
            # Constant, or a camera's path: known well enough without all frames at once.
            stats.stats |= {key: feature_stats(values) for key, values in calibration.items()}
    _finish(source, folder, features, columns, stats)


def make_masked_rgb(source: Source, folder: Path, features: Features, video: VideoConfig) -> None:
    """Write colour multiplied by attention of one episode."""

    def picture(frame: Frame, camera: CameraRecord) -> np.ndarray:
        attended = np.asarray(source.masks(frame, camera.name).any(axis=0))
        return np.asarray(frame.rgb[camera.name] * attended[..., None])

    stats = _encode_videos(source, folder, features, video, picture)
    columns: dict[str, Column] = {**_motion(source)}
    _finish(source, folder, features, columns, stats)


def _encode_videos(
    source: Source,
    folder: Path,
    features: Features,
    video: VideoConfig,
    picture: Callable[[Frame, CameraRecord], np.ndarray],
) -> PartStats:
    """Stream every frame of the episode once, each picture from the log to its encoder.

    AV1 encoders have threads that work on the pictures of frames before. Threads of our own beside
    them were tried, one per core: they take turns at Python's lock, and it took twice as long.
    """
    cameras = {c.name: c for c in source.cameras if image_key(c.name) in features}
    hz = source.manifest.hz
    counts = {name: PixelStats() for name in cameras}
    with contextlib.ExitStack() as stack:
        encoders = {
            name: stack.enter_context(
                VideoEncoder(folder / video_file(image_key(name)), video, c.width, c.height, hz)
            )
            for name, c in cameras.items()
        }
        for frame in source.episode.frames(list(cameras)):
            for name, camera in cameras.items():
                rgb = picture(frame, camera)
                encoders[name].add(rgb)
                counts[name].add(rgb)
    return PartStats(pixel_counts={image_key(n): each.counts for n, each in counts.items()})


def _motion(source: Source) -> dict[str, Column]:
    return {STATE: source.episode.state, ACTION: source.episode.actions}


def _calibration(source: Source, camera: str) -> dict[str, np.ndarray]:
    length = source.episode.num_frames
    K = source.camera_at(camera, 0).K
    return {
        intrinsics_key(camera): np.tile(K.reshape(9), (length, 1)).astype(np.float32),
        pose_key(camera): source.camera_poses(camera).reshape(length, 16).astype(np.float32),
    }


def _finish(
    source: Source,
    folder: Path,
    features: Features,
    columns: dict[str, Column],
    stats: PartStats,
) -> None:
    """Add the texts, then write table and statistics."""
    length = source.episode.num_frames
    own = {key: f for key, f in features.items() if isinstance(f, Feature)}
    columns[EPISODE_ID] = [source.episode.id] * length
    if LABELS in own:
        columns[LABELS] = [labels_json(source.folder)] * length
    if PROGRAM in own:
        manifest = source.manifest
        columns[PROGRAM] = [program_text(manifest.instruction, manifest.task)] * length
    write_columns(arrow_table(own, columns, length), folder / COLUMNS)
    stats.save(folder / STATS)
