from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codediffuser.errors import ConfigError, LabelError, SchemaVersionError, ShapeError
from codediffuser.labeling.perception.references import (
    BACKGROUND,
    DEFAULT_THRESHOLD,
    NOTHING,
    Reference,
    ReferenceLibrary,
    calibrate_threshold,
    classify,
    image_hash,
    load_references,
    make_reference,
)

IMAGE = np.zeros((6, 8, 3), np.uint8)
DIMENSIONS = 16


class Backend:
    """All that a library asks of a backend."""

    name = "dinov2-vits14"
    dimensions = DIMENSIONS

    def maps(self, *_: object) -> np.ndarray:
        raise AssertionError("a library computes nothing")


def reference(category: str, feature: np.ndarray) -> Reference:
    return make_reference(
        feature, IMAGE, category, episode="000001", frame=0, camera="left", pixel=(3, 2),
        by="ada", at="2026-01-01T00:00:00Z",
    )  # fmt: skip


def near(direction: int, rng: np.random.Generator, noise: float = 0.1) -> np.ndarray:
    """A feature of any length about an axis."""
    return rng.uniform(0.5, 5.0) * (
        np.eye(DIMENSIONS)[direction] + noise * rng.normal(size=DIMENSIONS)
    )


@pytest.fixture
def library() -> ReferenceLibrary:
    """Three mugs, three branches, two kinds of background."""
    rng = np.random.default_rng(0)
    found = ReferenceLibrary(backend=Backend.name, dimensions=DIMENSIONS)
    for axis, category in enumerate(["mug", "branch", BACKGROUND, BACKGROUND]):
        for _ in range(3):
            found = found.with_reference(reference(category, near(axis, rng)))
    return found


def test_features_belong_to_the_category_they_are_like(library: ReferenceLibrary) -> None:
    rng = np.random.default_rng(1)
    features = np.stack([near(axis, rng) for axis in (0, 1, 0, 1)])
    category, similarity = classify(features, library)
    assert [library.categories[k] for k in category] == ["mug", "branch", "mug", "branch"]
    assert (similarity > 0.8).all()


def test_background_references_reject(library: ReferenceLibrary) -> None:
    rng = np.random.default_rng(2)
    background = np.stack([near(axis, rng) for axis in (2, 3)])
    assert classify(background, library)[0].tolist() == [NOTHING, NOTHING]
    # Without them, what is a little like a mug would be one.
    between = (np.eye(DIMENSIONS)[0] + 1.2 * np.eye(DIMENSIONS)[2])[None]
    without = library.model_copy(
        update={
            "references": tuple(r for r in library.references if r.category != BACKGROUND),
            "threshold": 0.5,
        }
    )
    assert classify(between, without)[0][0] != NOTHING
    assert classify(between, library.model_copy(update={"threshold": 0.5}))[0][0] == NOTHING


def test_an_absent_category_gives_nothing(library: ReferenceLibrary) -> None:
    # A scene of branches alone: scaled to the scene, as upstream does, some would become mugs.
    rng = np.random.default_rng(3)
    features = np.stack([near(axis, rng) for axis in [1] * 50 + [7] * 50])
    category, _ = classify(features, library)
    assert (category[:50] == library.categories.index("branch")).all()
    assert (category[50:] == NOTHING).all()


def test_similarity_does_not_depend_on_the_rest_of_the_scene(library: ReferenceLibrary) -> None:
    rng = np.random.default_rng(4)
    features = rng.normal(size=(40, DIMENSIONS))
    category, similarity = classify(features, library)
    for k in range(40):
        alone = classify(features[k : k + 1] * 7.0, library)
        assert alone[0][0] == category[k]
        assert alone[1][0] == pytest.approx(similarity[k], abs=1e-6)


def test_points_that_nothing_sees_belong_to_nothing(library: ReferenceLibrary) -> None:
    features = np.zeros((2, DIMENSIONS))
    features[1, 0] = np.nan
    category, similarity = classify(features, library)
    assert category.tolist() == [NOTHING, NOTHING]
    assert similarity.tolist() == [-1, -1]
    assert classify(np.zeros((0, DIMENSIONS)), library)[0].shape == (0,)


def test_an_empty_library_finds_nothing() -> None:
    empty = ReferenceLibrary(backend="x", dimensions=DIMENSIONS)
    assert classify(np.ones((3, DIMENSIONS)), empty)[0].tolist() == [NOTHING] * 3
    assert empty.categories == ()


def test_the_threshold_is_calibrated_by_the_references(library: ReferenceLibrary) -> None:
    assert library.calibrated
    assert 0.5 < library.threshold < 0.95
    assert not ReferenceLibrary(backend="x", dimensions=2).calibrated
    one = ReferenceLibrary(backend="x", dimensions=DIMENSIONS).with_reference(
        reference("mug", np.ones(DIMENSIONS))
    )
    assert (one.calibrated, one.threshold) == (False, DEFAULT_THRESHOLD)
    # Background references need not be alike: they do not pull the threshold down.
    rng = np.random.default_rng(5)
    odd = library
    for _ in range(5):
        odd = odd.with_reference(reference(BACKGROUND, rng.normal(size=DIMENSIONS)))
    assert odd.threshold > 0.5


def test_the_threshold_lies_in_the_gap_or_where_errors_are_fewest() -> None:
    assert calibrate_threshold(np.array([0.8, 0.9]), np.array([0.2, 0.4])) == pytest.approx(0.6)
    # Also where all of one kind are exactly alike: not at them, but half way.
    assert calibrate_threshold(np.array([1.0, 1.0]), np.array([0.0, 0.0])) == pytest.approx(0.5)
    overlapping = calibrate_threshold(np.array([0.3, 0.7, 0.8, 0.9]), np.array([0.1, 0.2, 0.5]))
    assert overlapping == pytest.approx(0.6)
    assert calibrate_threshold(np.array([-0.5]), np.array([-0.9])) == 0.01


def test_a_library_survives_its_file_to_the_last_bit(
    library: ReferenceLibrary, tmp_path: Path
) -> None:
    path = tmp_path / "references.json"
    library.save(path)
    again = load_references(path, Backend())
    assert again == library
    for mine, theirs in zip(library.references, again.references, strict=True):
        np.testing.assert_array_equal(mine.feature, theirs.feature)
    kept = again.references[0]
    assert (kept.by, kept.at, kept.pixel) == ("ada", "2026-01-01T00:00:00Z", (3, 2))
    assert kept.image_sha256 == image_hash(IMAGE)


def test_a_reference_can_be_taken_back(library: ReferenceLibrary) -> None:
    more = library.with_reference(reference("mug", np.eye(DIMENSIONS)[5]))
    assert more.count("mug") == 4
    assert more.without(more.references[-1]) == library
    with pytest.raises(LabelError, match="no such reference of 'mug'"):
        library.without(more.references[-1])


def test_references_of_another_backend_are_refused(
    library: ReferenceLibrary, tmp_path: Path
) -> None:
    path = tmp_path / "references.json"
    library.model_copy(update={"backend": "dinov2-vitl14"}).save(path)
    with pytest.raises(ConfigError, match=r"of dinov2-vitl14 .* expected dinov2-vits14 with 16"):
        load_references(path, Backend())
    assert load_references(tmp_path / "none.json", Backend()).references == ()
    with pytest.raises(ShapeError, match=r"expected \(N, 16\) of dinov2-vits14, got \(2, 3\)"):
        classify(np.zeros((2, 3)), library)


def test_damaged_and_newer_libraries_are_refused(library: ReferenceLibrary, tmp_path: Path) -> None:
    path = tmp_path / "references.json"
    library.save(path)
    text = path.read_text()
    path.write_text(text.replace("references/1", "references/2"))
    with pytest.raises(SchemaVersionError, match="newer than this codediffuser"):
        load_references(path, Backend())
    path.write_text(text.replace('"dimensions": 16', '"dimensions": 15'))
    with pytest.raises(ConfigError, match="reference 0 has 16 numbers, expected 15"):
        load_references(path, Backend())
    path.write_text(text[: len(text) // 2])
    with pytest.raises(ConfigError, match=r"references\.json"):
        load_references(path, Backend())
    with pytest.raises(ConfigError, match="no direction"):
        ReferenceLibrary.parse(
            {
                "schema": "codediffuser.references/1", "backend": "x", "dimensions": 2,
                "references": [reference("mug", np.zeros(2)).model_dump()],
            },
            "here",
        )  # fmt: skip
