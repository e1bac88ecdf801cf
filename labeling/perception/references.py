"""Reference features: what the features of a category look like, chosen by people, in one file.

A point belongs to the category whose reference is most like its feature, by cosine similarity, and
only if that similarity reaches a threshold that was calibrated for the backend. Nothing is scaled
by what a scene happens to hold, so a category that is absent gives nothing; and a point that is
most like a background reference gives nothing either.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from codediffuser.errors import ConfigError, LabelError, ShapeError
from codediffuser.labeling.perception.features import FeatureBackend
from codediffuser.schema import Document, Strict

BACKGROUND = "background"
"""Category of references that reject."""

NOTHING = -1
"""Number of points that belong to no category."""

DEFAULT_THRESHOLD = 0.6
"""Until a library holds enough references to be calibrated by them."""


class Reference(Strict):
    """One feature, and where it comes from."""

    category: str
    """What it stands for; `background` rejects."""
    feature_base64: str
    """The feature, as the bytes of little-endian float32 numbers."""
    image_sha256: str
    """Of the picture, see `image_hash`."""
    episode: str
    frame: int
    camera: str
    pixel: tuple[int, int]
    """Column and row."""
    by: str
    """Who chose it."""
    at: str
    """When, ISO 8601, UTC."""

    @property
    def feature(self) -> np.ndarray:
        """(D,) float32."""
        return np.frombuffer(base64.b64decode(self.feature_base64), dtype="<f4")


class ReferenceLibrary(Document):
    """References of one backend (`schema: codediffuser.references/1`)."""

    KIND: ClassVar[str] = "references"
    VERSION: ClassVar[int] = 1

    backend: str
    """Name of the backend that made the features; others are not comparable."""
    dimensions: int = Field(gt=0)
    threshold: float = Field(default=DEFAULT_THRESHOLD, gt=0, le=1)
    """Smallest cosine similarity that counts."""
    calibrated: bool = False
    """Whether the threshold comes from the references themselves."""
    references: tuple[Reference, ...] = ()

    @model_validator(mode="after")
    def _features_fit(self) -> Self:
        for number, reference in enumerate(self.references):
            length = len(base64.b64decode(reference.feature_base64)) / 4
            if length != self.dimensions:
                raise ValueError(
                    f"reference {number} has {length:g} numbers, expected {self.dimensions}"
                )
            if not np.linalg.norm(reference.feature) > 0:
                raise ValueError(f"reference {number} is zero or not a number: it has no direction")
        return self

    @property
    def categories(self) -> tuple[str, ...]:
        """Categories that can be found, sorted: all but the background."""
        return tuple(sorted({r.category for r in self.references} - {BACKGROUND}))

    def count(self, category: str) -> int:
        """How many references a category has."""
        return sum(r.category == category for r in self.references)

    def with_reference(self, reference: Reference) -> ReferenceLibrary:
        """The library with one more reference, calibrated anew."""
        return self._calibrated((*self.references, reference))

    def without(self, reference: Reference) -> ReferenceLibrary:
        """The library without one of its references, calibrated anew.

        Raises:
            LabelError: It is not in the library.
        """
        kept = [r for r in self.references if r is not reference]
        if len(kept) == len(self.references):
            raise LabelError(
                f"the library has no such reference of '{reference.category}' at {reference.pixel}"
            )
        return self._calibrated(kept)

    def _calibrated(self, references: Sequence[Reference]) -> ReferenceLibrary:
        changed = self.model_copy(update={"references": tuple(references)})
        changed = ReferenceLibrary.model_validate(changed.model_dump(by_alias=True))
        same, different = reference_similarities(changed)
        if len(same) == 0 or len(different) == 0:
            update: dict[str, object] = {"threshold": DEFAULT_THRESHOLD, "calibrated": False}
        else:
            update = {"threshold": calibrate_threshold(same, different), "calibrated": True}
        return changed.model_copy(update=update)


def make_reference(
    feature: np.ndarray,
    image: np.ndarray,
    category: str,
    *,
    episode: str,
    frame: int,
    camera: str,
    pixel: tuple[int, int],
    by: str,
    at: str,
) -> Reference:
    """Describe a feature (D,) that somebody chose at a pixel (column, row) of a picture.

    Args:
        feature: (D,) float.
        image: (H, W, 3) uint8, the picture it was computed from.
        category: What it stands for, or `background`.
        episode: Id of the episode.
        frame: Number of the frame.
        camera: Name of the camera.
        pixel: Column and row.
        by: Who chose it.
        at: ISO 8601, UTC.
    """
    return Reference(
        category=category,
        feature_base64=base64.b64encode(np.asarray(feature, dtype="<f4").tobytes()).decode(),
        image_sha256=image_hash(image),
        episode=episode,
        frame=frame,
        camera=camera,
        pixel=pixel,
        by=by,
        at=at,
    )


def image_hash(image: np.ndarray) -> str:
    """Hex SHA-256 of the pixels of a picture (H, W, 3) uint8 RGB, row by row."""
    return hashlib.sha256(np.ascontiguousarray(image).tobytes()).hexdigest()


def load_references(path: Path, backend: FeatureBackend) -> ReferenceLibrary:
    """Read a library that must be of a backend; a new one when there is no file.

    Raises:
        ConfigError: The file is damaged, or of another backend: features of two networks, or of
            two sizes of one, have nothing in common.
        SchemaVersionError: The file was written by a newer codediffuser.
    """
    if not path.is_file():
        return ReferenceLibrary(backend=backend.name, dimensions=backend.dimensions)
    library = ReferenceLibrary.load(path)
    if (library.backend, library.dimensions) != (backend.name, backend.dimensions):
        raise ConfigError(
            f"{path}: its references are of {library.backend} with {library.dimensions} "
            f"dimensions, expected {backend.name} with {backend.dimensions}; choose that backend, "
            "or another file"
        )
    return library


def classify(features: np.ndarray, library: ReferenceLibrary) -> tuple[np.ndarray, np.ndarray]:
    """Say which category each feature belongs to, if any.

    Args:
        features: (N, D) float; a zero row, a point that nothing sees, belongs to nothing.
        library: Of the same backend.

    Returns:
        category: (N,) int64, index of `library.categories`, or `NOTHING`.
        similarity: (N,) float32, cosine to the nearest reference of any kind, -1 without one.

    Raises:
        ShapeError: The features do not have the library's dimensions.
    """
    if features.ndim != 2 or features.shape[1] != library.dimensions:
        raise ShapeError(
            f"features: expected (N, {library.dimensions}) of {library.backend}, "
            f"got {features.shape}"
        )
    names = (*library.categories, BACKGROUND)
    table = similarities(features, library, names)
    best = table.argmax(axis=1)
    similarity = table[np.arange(len(table)), best]
    found = (similarity >= library.threshold) & (best < len(library.categories))
    return np.where(found, best, NOTHING), similarity


def similarities(
    features: np.ndarray, library: ReferenceLibrary, categories: Sequence[str]
) -> np.ndarray:
    """Cosine of each feature to the nearest reference of each category: (N, C) float32.

    -1 for a category without references, and for features without a direction.
    """
    unit = _unit(features)
    table = np.full((len(features), len(categories)), -1.0, dtype=np.float32)
    for column, category in enumerate(categories):
        own = [r.feature for r in library.references if r.category == category]
        if own:
            table[:, column] = (unit @ _unit(np.stack(own)).T).max(axis=1)
    table[~np.any(unit, axis=1)] = -1.0
    return table


def reference_similarities(library: ReferenceLibrary) -> tuple[np.ndarray, np.ndarray]:
    """What a calibration compares: references with the nearest of their own and of other kinds.

    Returns:
        same: (A,) cosine of each reference to the nearest other one of its category.
        different: (B,) cosine of each to the nearest one of another category or background.
        Backgrounds are only compared with categories: they need not be alike.
    """
    kinds = np.array([r.category for r in library.references], dtype=object)
    if len(kinds) == 0:
        return np.zeros(0), np.zeros(0)
    unit = _unit(np.stack([r.feature for r in library.references]))
    cosine = unit @ unit.T
    alike = kinds[:, None] == kinds[None, :]
    others = alike & ~np.eye(len(kinds), dtype=bool)
    same = np.where(others, cosine, -np.inf).max(axis=1)[kinds != BACKGROUND]
    different = np.where(~alike, cosine, -np.inf).max(axis=1)
    return same[np.isfinite(same)], different[np.isfinite(different)]


def calibrate_threshold(same: np.ndarray, different: np.ndarray) -> float:
    """Choose the similarity that best parts pairs of one kind from pairs of two kinds.

    Args:
        same: (A,) cosines that should count, A >= 1.
        different: (B,) cosines that should not, B >= 1.

    Returns:
        The middle of the gap between the two. Where they overlap, the value with the smallest sum
        of the two error rates; of equals the highest, for a missed point costs less than a wrong
        one. Within [0.01, 1].
    """
    values = np.unique(np.concatenate([same, different]))
    # The last cut lies above all values: it keeps nothing.
    cuts = np.append((values[1:] + values[:-1]) / 2, values[-1] + 1e-6)
    missed = np.mean(same[None, :] < cuts[:, None], axis=1)
    wrong = np.mean(different[None, :] >= cuts[:, None], axis=1)
    total = missed + wrong
    best = len(total) - 1 - int(np.argmin(total[::-1]))
    return float(np.clip(cuts[best], 0.01, 1.0))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Rows of length 1, float32; rows without a direction become zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    usable = np.isfinite(length) & (length > 0)
    return np.where(usable, vectors / np.where(usable, length, 1), 0).astype(np.float32)
