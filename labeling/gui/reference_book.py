"""The references that the tabs of one server collect: one library file, one backend. No viser."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import threading
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from codediffuser.errors import EpisodeError, LabelError
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.label import utc_now
from codediffuser.labeling.perception.features import (
    FeatureBackend,
    FeatureOptions,
    get_features,
    sample_map,
)
from codediffuser.labeling.perception.references import (
    BACKGROUND,
    Reference,
    ReferenceLibrary,
    load_references,
    make_reference,
)

KEPT_MAPS = 8
"""Feature maps that are kept: a person clicks several times in one picture."""


class ReferenceBook:
    """Adds features of clicked pixels to a library file. Thread-safe; other servers may share it.

    Args:
        backend: Registered name of the feature backend.
        path: The library file; it need not exist.
        options: What the backend is built from; the episode is filled in here.
    """

    def __init__(self, backend: str, path: Path, options: FeatureOptions | None = None) -> None:
        self.backend, self.path = backend, path
        self._options = options or FeatureOptions()
        self._lock = threading.Lock()
        self._maps: OrderedDict[tuple[Path, str], tuple[FeatureBackend, np.ndarray]] = OrderedDict()

    def categories(self, scene: EpisodeScene) -> tuple[str, ...]:
        """What a pixel of an episode can be a reference for: its task's roles, or background."""
        return (*(need.category for need in scene.needs), BACKGROUND)

    def read(self) -> ReferenceLibrary | None:
        """The library as it is on disk; None when there is no file yet.

        Raises:
            ConfigError: The file is damaged or written by a newer codediffuser.
        """
        return ReferenceLibrary.load(self.path) if self.path.is_file() else None

    def add(
        self, scene: EpisodeScene, camera: str, pixel: tuple[int, int], category: str, by: str
    ) -> ReferenceLibrary:
        """Keep the feature of a pixel (column, row) of frame 0 as a reference.

        Returns:
            The library, which is on disk.

        Raises:
            LabelError: The pixel lies beside the picture, or the picture cannot be read.
            ConfigError: The file is damaged, or holds references of another backend.
            SetupError: The backend's weights are missing.
        """
        if scene.start is None or camera not in scene.start.rgb:
            raise LabelError(scene.problem or f"the picture of '{camera}' cannot be read")
        image = scene.start.rgb[camera]
        if not (0 <= pixel[0] < image.shape[1] and 0 <= pixel[1] < image.shape[0]):
            raise LabelError("that is beside the picture: click on it")
        backend, feature_map = self._map(scene, camera)
        feature = sample_map(feature_map, np.array([pixel], dtype=float), image.shape[:2])[0]
        reference = make_reference(
            feature, image, category, episode=scene.id, frame=0, camera=camera, pixel=pixel,
            by=by, at=utc_now(),
        )  # fmt: skip
        with self._writing():
            library = load_references(self.path, backend).with_reference(reference)
            library.save(self.path)
        return library

    def remove_last(self, by: str) -> Reference:
        """Take away the last reference that somebody made.

        Raises:
            LabelError: There is none.
        """
        with self._writing():
            library = self.read()
            mine = [r for r in library.references if r.by == by] if library else []
            if library is None or not mine:
                raise LabelError(f"{by} has made no reference that could be taken away")
            library.without(mine[-1]).save(self.path)
            return mine[-1]

    def marked(self, scene: EpisodeScene, camera: str) -> list[Reference]:
        """References that were clicked in a picture of frame 0."""
        library = self.read()
        return [
            r
            for r in (library.references if library else ())
            if (r.episode, r.camera, r.frame) == (scene.id, camera, 0)
        ]

    def _map(self, scene: EpisodeScene, camera: str) -> tuple[FeatureBackend, np.ndarray]:
        """The map (h, w, D) of a picture of frame 0, and what made it."""
        key = (scene.folder, camera)
        with self._lock:
            if key not in self._maps:
                self._maps[key] = self._compute_map(scene, camera)
            self._maps.move_to_end(key)
            while len(self._maps) > KEPT_MAPS:
                self._maps.popitem(last=False)
            return self._maps[key]

    def _compute_map(self, scene: EpisodeScene, camera: str) -> tuple[FeatureBackend, np.ndarray]:
        if scene.start is None:
            raise EpisodeError(scene.problem)
        backend = self._backend(scene)
        maps = backend.maps(
            scene.start.rgb[camera][None],
            scene.start.depth_m[camera][None],
            (scene.cameras[camera],),
        )
        return backend, maps[0]

    def _backend(self, scene: EpisodeScene) -> FeatureBackend:
        options = dataclasses.replace(self._options, episode=scene.episode)
        return get_features(self.backend, options)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """One writer at a time, also among servers that share the file."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self._lock, self.path.with_name(f".{self.path.name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
