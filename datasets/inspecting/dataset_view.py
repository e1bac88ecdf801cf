"""Episodes of a LeRobot dataset for the viewers: whatever of cloud, depth and videos it holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from codediffuser.datagen.episode_format import METRES_PER_MM, Camera
from codediffuser.datasets import parquet_reader
from codediffuser.datasets.export_meta import load_info
from codediffuser.datasets.exporting.pictures import picture_of
from codediffuser.datasets.features import (
    ACTION,
    POINT_CHANNELS,
    POINTS,
    STATE,
    depth_key,
    intrinsics_key,
    mask_key,
    pose_key,
)
from codediffuser.datasets.inspecting.dataset_survey import column_names, episode_names
from codediffuser.datasets.inspecting.episode_view import (
    MAX_POINTS,
    Shelf,
    Shot,
    colored_points,
    joined,
    paint,
)
from codediffuser.errors import DatasetError

IMAGES = "observation.images."
LOW_RGB, HIGH_RGB = np.array([70, 78, 90]), np.array([196, 202, 210])
"""A cloud without colours is shaded by height."""


class DatasetView:
    """One episode of a dataset.

    Args:
        root: The dataset.
        row: Its row of `meta/episodes`.
        name: What it is called.

    Raises:
        DatasetError: Its files are damaged.
    """

    def __init__(self, root: Path, row: Mapping[str, Any], name: str) -> None:
        self._root, self._row, self._info = root, row, load_info(root)
        self.id, self.hz = name, float(self._info["fps"])
        self.title = "; ".join(row["tasks"])
        self._table = _read_table(root, self._info, row)
        self.state, self.action = self._numbers(STATE), self._numbers(ACTION)
        self.names = column_names(self._info, STATE), column_names(self._info, ACTION)

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """Cameras whose calibration is stored, as they stand at first."""
        return self._cameras_at(0)

    def shot(self, k: int) -> Shot:
        """Pictures of frame k, and its cloud: the stored one, or that of depth pictures.

        Raises:
            DatasetError: A picture is damaged.
        """
        pictures = self._pictures(k)
        return Shot(*(self._stored_cloud(k) or self._seen_cloud(k, pictures)), pictures)

    def _stored_cloud(self, k: int) -> tuple[np.ndarray, np.ndarray] | None:
        channels = len(POINT_CHANNELS)
        if POINTS not in self._table.column_names:
            return None
        flat = np.asarray(self._table[POINTS][k].as_py(), dtype=np.float32)
        if flat.size % channels:
            return None
        cloud = flat.reshape(-1, channels)
        height = cloud[:, 2]
        share = (height - height.min()) / max(float(np.ptp(height)), 1e-6)
        shaded = LOW_RGB + share[:, None] * (HIGH_RGB - LOW_RGB)
        return cloud[:, :3], paint(shaded.astype(np.uint8), cloud[:, 3:])

    def _seen_cloud(
        self, k: int, pictures: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        clouds, colors = [], []
        for name, camera in self._cameras_at(k).items():
            if depth_key(name) not in self._table.column_names or name not in pictures:
                continue
            depth_m = picture_of(self._table[depth_key(name)][k].as_py()) * METRES_PER_MM
            points, rgb, pixel = colored_points(depth_m, pictures[name], camera)
            if mask_key(name) in self._table.column_names:
                bits = picture_of(self._table[mask_key(name)][k].as_py()).reshape(-1)[pixel]
                rgb = paint(rgb, np.stack([bits & 1, bits & 2], axis=1))
            clouds.append(points)
            colors.append(rgb)
        points, rgb = joined(clouds, 3, np.float32), joined(colors, 3, np.uint8)
        step = max(1, -(-len(points) // MAX_POINTS))
        return points[::step], rgb[::step]

    def _cameras_at(self, k: int) -> dict[str, Camera]:
        cameras = {}
        for key, feature in self._info["features"].items():
            name = key.removeprefix(IMAGES)
            if not key.startswith(IMAGES) or intrinsics_key(name) not in self._table.column_names:
                continue
            K = np.array(self._table[intrinsics_key(name)][k].as_py(), dtype=np.float64)
            T = np.array(self._table[pose_key(name)][k].as_py(), dtype=np.float64)
            height, width = feature["shape"][:2]
            cameras[name] = Camera(K.reshape(3, 3), T.reshape(4, 4), width, height)
        return cameras

    def _pictures(self, k: int) -> dict[str, np.ndarray]:
        pictures = {}
        for key, feature in self._info["features"].items():
            name = key.removeprefix(IMAGES)
            if feature["dtype"] == "video":
                pictures[name] = self._video_frame(key, k)
            elif feature["dtype"] == "image":
                pictures[name] = _decode(self._table[key][k].as_py()["bytes"], key)
        return pictures

    def _video_frame(self, key: str, k: int) -> np.ndarray:
        from lerobot.datasets.video_utils import decode_video_frames

        place = {n: self._row[f"videos/{key}/{n}"] for n in ("chunk_index", "file_index")}
        path = self._root / self._info["video_path"].format(video_key=key, **place)
        time_s = self._row[f"videos/{key}/from_timestamp"] + k / self.hz
        try:
            found = decode_video_frames(path, [time_s], 0.5 / self.hz, backend="pyav")
        except (OSError, RuntimeError, AssertionError, ValueError) as error:
            raise DatasetError(f"{path}: no picture at {time_s:.3f} s: {error}") from None
        return np.asarray(found[0].permute(1, 2, 0).mul(255).round().byte().numpy())

    def _numbers(self, key: str) -> np.ndarray:
        if key not in self._table.column_names:
            return np.zeros((len(self._table), 0), dtype=np.float32)
        return np.array(self._table[key].to_pylist(), dtype=np.float32).reshape(
            len(self._table), -1
        )


def _decode(data: bytes, key: str) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise DatasetError(f"{key}: a row holds no picture that can be read")
    return np.ascontiguousarray(picture[..., ::-1])


def dataset_shelf(root: Path) -> Shelf:
    """The episodes of a dataset, by the id of their source where it is stored.

    Raises:
        DatasetError: There is no dataset, or it is damaged.
    """
    rows = parquet_reader.read_episode_rows(root)
    ids = episode_names(root, len(rows))
    if len(set(ids)) < len(ids):  # a merge of runs that numbered their scenes alike
        ids = tuple(f"{i}: {name}" for i, name in enumerate(ids))
    by_id = dict(zip(ids, rows, strict=True))
    return Shelf(ids, lambda name: DatasetView(root, by_id[name], name))


def _read_table(root: Path, info: Mapping[str, Any], row: Mapping[str, Any]) -> pa.Table:
    place = {n: row[f"data/{n}"] for n in ("chunk_index", "file_index")}
    path = root / info["data_path"].format(**place)
    try:
        table = pq.read_table(path, filters=[("episode_index", "==", row["episode_index"])])
    except (pa.ArrowException, OSError) as error:
        raise DatasetError(f"{path}: not readable: {error}") from None
    if len(table) != row["length"]:
        raise DatasetError(
            f"{path}: expected {row['length']} frames of episode {row['episode_index']}, "
            f"got {len(table)}"
        )
    return table
