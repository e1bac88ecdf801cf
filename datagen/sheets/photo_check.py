"""A photo of a pad against the configuration that should lie on it.

The tags beside the pad give the plane of the table in the photo; the configuration is drawn onto
it, so that an operator sees what still differs. Only what lies in that plane is drawn where it is:
a thing's foot fits its disc, and its top leans away from the camera.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codediffuser.datagen.drawing import Drawing
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.sheets.photo_overlay import draw_over, project
from codediffuser.datagen.sheets.tags import CORNERS, DICTIONARY, PadSheet, pad_sheets
from codediffuser.datagen.task import TASKS, Task, get_task
from codediffuser.errors import CodeDiffuserError, ConfigError
from codediffuser.files import write_bytes

MIN_TAGS = 3
"""Of the four of a pad. Two on one side would leave the other side to extrapolation."""
MAX_RESIDUAL_MM = 0.6
"""RMS over all corners. Photos of a flat print stay below 0.4; a tile that is taped 12 mm off, a
bent sheet or a curved lens shows here. A print of another scale fits as well: hence the ruler."""


@dataclass(frozen=True, slots=True)
class PadView:
    """Where a pad lies in a photo."""

    sheet: PadSheet
    H_image_world: np.ndarray
    """(3, 3) float64, from x and y on the table in metres to column and row in pixels."""
    corners_seen: tuple[str, ...]
    """Corners whose tags were found."""
    residual_px: float
    """RMS distance between tag corners in the photo and where the plane puts them."""
    residual_mm: float
    """The same on the table."""


@dataclass(frozen=True, slots=True)
class PhotoCheck:
    """A photo with the configuration drawn over it."""

    views: tuple[PadView, ...]
    image_rgb: np.ndarray
    """(H, W, 3) uint8."""

    @property
    def note(self) -> str:
        """One line a pad: tags and residual."""
        return "; ".join(
            f"{view.sheet.title}: {len(view.corners_seen)} of 4 tags, "
            f"residual {view.residual_px:.2f} px = {view.residual_mm:.2f} mm"
            for view in self.views
        )


def check_photo(photo: Path, scene_path: Path, out: Path) -> PhotoCheck:
    """Draw a scene over a photo of its pads and write the picture to `out` as PNG.

    Raises:
        ConfigError: The photo or the scene cannot be read, or a pad cannot be placed in the photo;
            the message says why and what to try.
    """
    scene = SceneSpec.load(scene_path)
    task = get_task(scene.task)
    rgb = read_photo(photo)
    try:
        views = find_pads(rgb, task, scene.variant)
    except CodeDiffuserError as error:
        raise ConfigError(f"{photo}: {error}") from None
    check = PhotoCheck(views, _draw_views(rgb, task.draw_reset(scene), views))
    write_bytes(out, _encode_png(check.image_rgb))
    return check


def read_photo(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB of a picture file, turned as its camera noted.

    Raises:
        ConfigError: The file is missing or no picture.
    """
    import cv2

    if not path.is_file():
        raise ConfigError(f"{path}: no such photo")
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if bgr is None:
        raise ConfigError(f"{path}: expected a picture (JPEG or PNG), got something else")
    return np.ascontiguousarray(bgr[..., ::-1])


def find_pads(rgb: np.ndarray, task: Task, variant: str) -> tuple[PadView, ...]:
    """Place every pad of a variant in a photo.

    Args:
        rgb: (H, W, 3) uint8.
        task: Whose pads.
        variant: Which of its pads.

    Raises:
        ConfigError: A pad shows fewer than `MIN_TAGS` tags, or does not fit a plane.
    """
    sheets = pad_sheets(task.name, variant, task.pads(variant))
    seen = detect_tags(rgb)
    expected = {tag.number for sheet in sheets for tag in sheet.tags}
    if expected.isdisjoint(seen):
        raise ConfigError(_why_none(rgb, seen, expected, f"{task.name} {variant}"))
    return tuple(locate(sheet, seen) for sheet in sheets)


def detect_tags(rgb: np.ndarray) -> dict[int, np.ndarray]:
    """Corners (4, 2) float64 in pixels of every tag in a photo, by number.

    Pixel centres lie on whole numbers. Of two tags with one number, neither is taken.
    """
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(gray)
    if numbers is None:
        return {}
    found = [int(number) for number in np.ravel(numbers)]
    return {
        number: np.asarray(quad, dtype=np.float64).reshape(4, 2)
        for number, quad in zip(found, corners, strict=True)
        if found.count(number) == 1
    }


def locate(sheet: PadSheet, seen: dict[int, np.ndarray]) -> PadView:
    """Fit the plane of one pad to the corners of its tags, by least squares in the photo.

    Raises:
        ConfigError: Fewer than `MIN_TAGS` tags are seen, or the residual is too large.

    Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., algorithm 4.3 (gold standard with
    errors in one image).
    """
    import cv2

    named = list(zip(CORNERS, sheet.tags, strict=True))
    found = [(name, tag) for name, tag in named if tag.number in seen]
    if len(found) < MIN_TAGS:
        missing = [name for name, tag in named if tag.number not in seen]
        raise ConfigError(
            f"expected at least {MIN_TAGS} of the 4 tags of {sheet.title}, found {len(found)}; not "
            f"seen: {', '.join(missing)}. Uncover them, or take a sharper or nearer photo"
        )
    world = np.concatenate([tag.corners_m() for _, tag in found])
    image = np.concatenate([seen[tag.number] for _, tag in found])
    H, _ = cv2.findHomography(world, image, 0)
    if H is None:
        raise ConfigError(f"{sheet.title}: the tags lie on one line in the photo; look from above")
    residual_px = _rms(project(H, world) - image)
    residual_mm = 1000 * _rms(project(np.linalg.inv(H), image) - world)
    if not residual_mm <= MAX_RESIDUAL_MM:
        raise ConfigError(
            f"{sheet.title}: expected its tags to fit a plane within {MAX_RESIDUAL_MM} mm, got "
            f"{residual_mm:.1f} mm ({residual_px:.1f} px). Is the sheet flat, printed at 100 % "
            "(check its ruler), its tiles joined at the cut marks, are its tags 40 pixels wide or "
            "more, and is the photo free of fisheye?"
        )
    return PadView(sheet, H, tuple(name for name, _ in found), residual_px, residual_mm)


def _rms(offsets: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(offsets**2, axis=1))))


def _why_none(rgb: np.ndarray, seen: dict[int, np.ndarray], expected: set[int], whose: str) -> str:
    """What is in the photo, when no tag of the pads asked for is."""
    if not expected.isdisjoint(detect_tags(np.ascontiguousarray(rgb[:, ::-1]))):
        return f"the photo is mirrored, so no tag of {whose} can be read; turn mirroring off"
    others = {
        sheet.title for sheet in _all_sheets() if {tag.number for tag in sheet.tags} & set(seen)
    }
    if others:
        return f"expected the pad of {whose}, found that of {', '.join(sorted(others))}"
    if len(seen) >= MIN_TAGS:
        return (
            f"expected the pad of {whose}, found tags {', '.join(map(str, sorted(seen)))} of a pad "
            "that no task has; was it printed before its YAML changed? Print pads.pdf anew"
        )
    return (
        f"expected the tags beside the pad of {whose}, found none; is the sheet from pads.pdf in "
        "the photo, sharp, lit, and at least 40 pixels to a tag?"
    )


def _all_sheets() -> Iterator[PadSheet]:
    """Pads of every registered task."""
    for name in TASKS.names():
        task = get_task(name)
        for variant in task.config.variants:
            yield from pad_sheets(name, variant, task.pads(variant))


def _draw_views(rgb: np.ndarray, drawing: Drawing, views: Sequence[PadView]) -> np.ndarray:
    """Paint every shape by the pad that it lies nearest to."""
    shapes = [shape for panel in drawing.panels if panel.view == "above" for shape in panel.shapes]
    return draw_over(rgb, shapes, [(view.sheet.pad, view.H_image_world) for view in views])


def _encode_png(rgb: np.ndarray) -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", rgb[..., ::-1])[1])
