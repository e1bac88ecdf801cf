"""Feature maps kept on disk by the content of their pictures, for backends that take seconds."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from codediffuser.datagen.episode_format import Camera
from codediffuser.files import atomic_path
from codediffuser.labeling.perception.features import FeatureBackend


class CachedFeatures:
    """A backend of colour alone whose maps are computed once for each picture.

    Pictures that are not known yet are computed together, in one batch. Several processes may
    share a folder: a file is whole or absent. A damaged file is computed again.

    Args:
        backend: What computes; it must map each picture by itself and look at nothing else.
        folder: Where the maps are kept; disposable.
        fingerprint: Changes with whatever else than the pictures decides the maps.
    """

    def __init__(self, backend: FeatureBackend, folder: Path, fingerprint: str) -> None:
        self.backend = backend
        self.folder = folder
        self.fingerprint = fingerprint

    @property
    def name(self) -> str:
        """That of the backend."""
        return self.backend.name

    @property
    def dimensions(self) -> int:
        """That of the backend."""
        return self.backend.dimensions

    def maps(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None = None,
        cameras: Sequence[Camera] | None = None,
    ) -> np.ndarray:
        """The backend's maps, from disk where they are known."""
        paths = [self._path(image) for image in images]
        known = [_read(path, self.dimensions) for path in paths]
        missing = [k for k, found in enumerate(known) if found is None]
        if missing:
            for k, computed in zip(missing, self.backend.maps(images[missing]), strict=True):
                known[k] = computed
                with atomic_path(paths[k]) as partial:
                    np.save(partial, computed)
        return np.stack([found for found in known if found is not None])

    def _path(self, image: np.ndarray) -> Path:
        digest = hashlib.sha256(f"{self.fingerprint} {image.shape} {image.dtype} ".encode())
        digest.update(np.ascontiguousarray(image).tobytes())
        key = digest.hexdigest()
        return self.folder / self.name / key[:2] / f"{key}.npy"


def _read(path: Path, dimensions: int) -> np.ndarray | None:
    try:
        found = np.asarray(np.load(path))
    except (OSError, ValueError, EOFError):
        return None
    return found if found.ndim == 3 and found.shape[-1] == dimensions else None
