"""Camera pictures and clouds with the attention that a selection would give, at any frame."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from codediffuser.datagen.episode import Frame
from codediffuser.errors import CodeDiffuserError
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.gui.draft import Selection
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.label import AttentionLabel, Provenance
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.pointcloud import backproject_depth, inside_box

PICK_RGB = (255, 120, 0)
PLACE_RGB = (0, 170, 80)
ROLE_RGB = (PICK_RGB, PLACE_RGB)
TINT = 0.65
GAP = 4
"""Pixels between the pictures of the sheet."""

_UNSAVED = Provenance("human", "", "")


class MovingAttention:
    """Where a selection's attention lies while the episode goes on.

    Args:
        scene: The episode.
        selection: What is selected; incomplete ones are shown as far as they go.
    """

    def __init__(self, scene: EpisodeScene, selection: Selection) -> None:
        self._scene = scene
        labels = _known(scene, selection)
        self._motion: RecordedMotion | None = None
        if scene.episode is not None:
            try:
                self._motion = RecordedMotion(scene.episode, labels)
            except CodeDiffuserError:
                # Nobody recorded the motion: only what stands still can be shown.
                labels = [label for label in labels if label.follows is None]
        start = self._motion.at(0) if self._motion else {}
        self._field = AttentionField(labels, start)

    def at(self, points_world: np.ndarray, frame: int) -> np.ndarray:
        """Attention (N, 2) of a cloud at a frame."""
        now = self._motion.at(frame) if self._motion else {}
        return self._field.at(points_world, now)


def camera_sheet(
    scene: EpisodeScene, frame: Frame, attention: MovingAttention, *, columns: int = 2
) -> np.ndarray:
    """All cameras' pictures of one frame on a sheet, attended pixels tinted by role.

    A pixel is attended when the point that it shows is, so nothing hidden is tinted.

    Returns:
        sheet: (H, W, 3) uint8; a small grey one for an episode without cameras.
    """
    tiles = []
    for name, camera in scene.cameras.items():
        rgb = frame.rgb[name].copy()
        points, pixel = backproject_depth(frame.depth_m[name], camera.K, camera.T_world_camera)
        near = _in_workspace(scene, points)
        attended = attention.at(points[near], frame.index)
        flat = rgb.reshape(-1, 3)
        for channel, color in enumerate(ROLE_RGB):
            mask = np.zeros(len(flat), np.uint8)
            mask[pixel[near][attended[:, channel] > 0]] = 1
            mask = cv2.dilate(mask.reshape(rgb.shape[:2]), np.ones((3, 3), np.uint8)).reshape(-1)
            chosen = mask > 0
            flat[chosen] = ((1 - TINT) * flat[chosen] + TINT * np.array(color)).astype(np.uint8)
        tiles.append(_captioned(rgb, name))
    return _sheet(tiles, columns)


def colored_cloud(
    scene: EpisodeScene, frame: Frame, attention: MovingAttention, *, limit: int = 25_000
) -> tuple[np.ndarray, np.ndarray]:
    """The fused cloud of one frame in its own colours, attended points in those of their role.

    Returns:
        points_world: (N, 3) float32, N at most `limit`.
        rgb: (N, 3) uint8.
    """
    clouds, colors = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.uint8)]
    for name, camera in scene.cameras.items():
        points, pixel = backproject_depth(frame.depth_m[name], camera.K, camera.T_world_camera)
        near = _in_workspace(scene, points)
        clouds.append(points[near])
        colors.append(frame.rgb[name].reshape(-1, 3)[pixel[near]])
    points, rgb = np.concatenate(clouds), np.concatenate(colors)
    stride = max(1, -(-len(points) // limit))
    points, rgb = points[::stride], rgb[::stride].copy()
    attended = attention.at(points, frame.index)
    for channel, color in enumerate(ROLE_RGB):
        rgb[attended[:, channel] > 0] = color
    return points, rgb


def outlines(points: np.ndarray, width: int, height: int) -> list[np.ndarray]:
    """Outer contours of a set of pixels (N, 2) (column, row), small gaps closed.

    Returns:
        Closed polygons (M, 2) float64 along the pixels' outer edges' centres, specks left out.
    """
    mask = np.zeros((height, width), np.uint8)
    columns, rows = points.astype(np.int64).T
    mask[rows, columns] = 1
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    large = [c for c in found if cv2.contourArea(c) >= 0.05 * max(map(cv2.contourArea, found))]
    return [c[:, 0].astype(np.float64) for c in large if len(c) >= 3]


def _known(scene: EpisodeScene, selection: Selection) -> list[AttentionLabel]:
    shown = tuple(item for item in selection if scene.instance(item[1]) is not None)
    return list(scene.labels(shown, _UNSAVED))


def _in_workspace(scene: EpisodeScene, points: np.ndarray) -> np.ndarray:
    if scene.task is None:
        return np.zeros(len(points), dtype=bool)
    box = scene.task.config.workspace
    return inside_box(points, np.array(box.low_m), np.array(box.high_m))


def _captioned(rgb: np.ndarray, text: str) -> np.ndarray:
    scale = rgb.shape[1] / 640
    for color, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(
            rgb, text, (4, rgb.shape[0] - 6), cv2.FONT_HERSHEY_SIMPLEX, max(0.35, scale), color,
            thickness, cv2.LINE_AA,
        )  # fmt: skip
    return rgb


def _sheet(tiles: Sequence[np.ndarray], columns: int) -> np.ndarray:
    if not tiles:
        return np.full((60, 200, 3), 230, np.uint8)
    height = max(t.shape[0] for t in tiles)
    width = max(t.shape[1] for t in tiles)
    rows = -(-len(tiles) // columns)
    sheet = np.full(
        (rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), 255, np.uint8
    )  # fmt: skip
    for i, tile in enumerate(tiles):
        y, x = (i // columns) * (height + GAP), (i % columns) * (width + GAP)
        sheet[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
    return sheet
