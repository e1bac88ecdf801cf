"""One labelled episode as exports see it: frames, cameras, attention on pictures, texts."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.datagen.episode import Episode, Frame
from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import InstructionError, NotRegisteredError
from codediffuser.files import sha256_json
from codediffuser.labeling.attention import RADIUS_M, AttentionField
from codediffuser.labeling.attention_2d import DILATION_PX, role_masks
from codediffuser.labeling.motion import RecordedMotion
from codediffuser.labeling.store import load_labels

NOT_EXPORTED = ("history", "saved", "flags", "reviews")
"""Of a label file: what tells how it came about, not what it says."""


class Source:
    """An episode with its labels, if it has any.

    Args:
        folder: `RUN/episodes/<id>`.
        labelled: Whether its labels are wanted.
        dilation_px: How far attention reaches around a labelled point on a picture.

    Raises:
        EpisodeError: The episode is damaged.
        LabelError: Its labels are missing or damaged.
    """

    def __init__(
        self, folder: Path, *, labelled: bool = True, dilation_px: int = DILATION_PX
    ) -> None:
        self.folder = folder
        self.episode = Episode.open(folder)
        self.manifest = self.episode.manifest
        self.cameras = self.manifest.cameras
        self._dilation_px = dilation_px
        self._calibrations: dict[str, tuple[tuple[np.ndarray, int, int], np.ndarray]] = {}
        self._carried_at: tuple[int, Any] = (-1, None)
        self.labels = load_labels(folder).labels if labelled else ()

    def camera_at(self, name: str, k: int) -> Camera:
        """Calibration of one camera at frame k.

        Raises:
            EpisodeError: It is not calibrated.
        """
        (K, width, height), poses = self._calibration(name)
        return Camera(K, poses[k], width, height)

    def camera_poses(self, name: str) -> np.ndarray:
        """T_world_camera (T, 4, 4) float64."""
        return self._calibration(name)[1]

    def _calibration(self, name: str) -> tuple[tuple[np.ndarray, int, int], np.ndarray]:
        if name not in self._calibrations:
            self._calibrations[name] = (
                self.episode.camera_info(name), self.episode.camera_poses(name),
            )  # fmt: skip
        return self._calibrations[name]

    def masks(self, frame: Frame, camera: str) -> np.ndarray:
        """Attention on the picture of a calibrated camera, (2, H, W) bool pick before place."""
        return role_masks(
            *self._carried(frame.index),
            self.camera_at(camera, frame.index),
            frame.depth_m.get(camera),
            dilation_px=self._dilation_px,
        )

    def _carried(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Labelled points and their attention at frame k; all cameras of a frame share them."""
        if self._carried_at[0] != k:
            self._carried_at = k, self._field.carried(self._motion.at(k))
        return self._carried_at[1]

    @functools.cached_property
    def _motion(self) -> RecordedMotion:
        return RecordedMotion(self.episode, self.labels)

    @functools.cached_property
    def _field(self) -> AttentionField:
        return AttentionField(self.labels, self._motion.at(0), radius_m=RADIUS_M)


def labels_json(folder: Path) -> str:
    """The labels of an episode as one line of JSON: targets and who set them."""
    document = load_labels(folder).document.model_dump(mode="json", by_alias=True)
    for key in NOT_EXPORTED:
        document.pop(key, None)
    return json.dumps(document, sort_keys=True, separators=(",", ":"))


def labels_sha256(folder: Path) -> str:
    """Hash of what the labels of an episode say; reviews and flags do not change it."""
    return sha256_json(labels_json(folder))


def program_text(instruction: str, task: str) -> str:
    """The program that the built-in composer writes, empty for a sentence that it refuses."""
    from codediffuser.labeling.language.composer import compose_program
    from codediffuser.labeling.language.vocabulary import vocabulary_of

    try:
        return compose_program(instruction, vocabulary=vocabulary_of(task))
    except (InstructionError, NotRegisteredError):
        return ""
