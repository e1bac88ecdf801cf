"""Exports a run, imports it again, and compares every value.

python -m codediffuser.datasets.importing.round_trip RUN --num-episodes 2

Nothing is told to the import that a user would not know: it takes the first guess of
`import --inspect`, the task, and for bags the folder of scenes.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datasets.convert import convert_run
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.first_config import guess_config
from codediffuser.datasets.importing.run import import_recordings
from codediffuser.datasets.importing.sources import find_sources
from codediffuser.datasets.importing.survey import survey_source
from codediffuser.errors import DatasetError
from codediffuser.measuring import print_measured

RoundTrip = Literal["rosbag2", "aloha", "robomimic", "zarr"]
TOLERANCE = {"state": 1e-6, "action": 1e-6, "colour": 0.0, "depth": 0.0, "camera": 1e-12}
"""Of state and action in metres and parts of a rotation matrix: float32 rows go through
quaternions. Of camera poses likewise, in float64; K is exact. Pictures are exact."""


@dataclass(kw_only=True)
class Options:
    """Export episodes of a run in several formats, import them again, and compare."""

    run: tyro.conf.Positional[Path]
    """A run with episodes."""
    formats: tuple[RoundTrip, ...] = ("rosbag2", "aloha", "robomimic", "zarr")
    num_episodes: int = 2


@dataclass(frozen=True, slots=True)
class Compared:
    """How far values of one round trip are from those they began as."""

    to: RoundTrip
    episodes: int
    frames: int
    pictures: int
    """Of colour; as many of depth from cameras that have it."""
    difference: dict[str, float]
    """Greatest, by what `TOLERANCE` names. Formats without calibration have no `camera`."""

    def __str__(self) -> str:
        told = ", ".join(
            f"{what} {found:.1e} (allowed {TOLERANCE[what]:.0e})"
            for what, found in self.difference.items()
        )
        return (
            f"{self.to:10} {self.episodes} episodes, {self.frames} frames, "
            f"{self.pictures} pictures; greatest differences: {told}"
        )


def measure(options: Options, scratch: Path) -> str:
    """Compare every format; one line each.

    Raises:
        DatasetError: Something came back other than within `TOLERANCE`.
    """
    run = scratch / "run"
    for folder in list_episodes(options.run)[: options.num_episodes]:
        shutil.copytree(folder, run / "episodes" / folder.name)
        (run / "scenes").mkdir(exist_ok=True)
        shutil.copy(folder / "scene.yaml", run / "scenes" / f"{folder.name}.yaml")
    return "\n".join(str(round_trip(run, to, scratch / to)) for to in options.formats)


def round_trip(run: Path, to: RoundTrip, scratch: Path) -> Compared:
    """Export a simulated run, import it again, and compare.

    Args:
        run: All its episodes succeeded.
        to: Format of the export.
        scratch: Where both go.

    Raises:
        DatasetError: An episode was refused, or something differs by more than `TOLERANCE`.
    """
    for _ in convert_run(run, scratch / "export", to=to, profile="portable"):
        pass
    source = next((scratch / "export").glob("*.zarr"), scratch / "export")
    made = [Episode.open(folder) for folder in list_episodes(run)]
    guess = guess_config(survey_source(find_sources(source)[0]), made[0].manifest.task)
    # JPEG files of a bag travel as they are; decoded colour stays as it is in PNG.
    told: dict[str, Any] = {"image": {"format": "png"}}
    if to == "rosbag2":
        told = {"source": "simulation", "scenes": {"folder": str(run / "scenes")}}
    config = ImportConfig.parse(guess | told, "first guess")
    results = list(import_recordings(source, config, scratch / "run"))
    if refused := [r.reason for r in results if r.outcome != "imported"]:
        raise DatasetError(f"{to}: {len(refused)} episodes were refused: {refused[0]}")
    again = [Episode.open(folder) for folder in list_episodes(scratch / "run")]
    return compare(to, made, again, calibrated=to == "rosbag2")


def compare(
    to: RoundTrip, made: Sequence[Episode], again: Sequence[Episode], *, calibrated: bool
) -> Compared:
    """Compare episodes value by value.

    Args:
        to: What they went through.
        made: As they were.
        again: As they came back, in the same order.
        calibrated: Whether cameras had to come back too.

    Raises:
        DatasetError: Something differs by more than `TOLERANCE`.
    """
    found = dict.fromkeys([k for k in TOLERANCE if calibrated or k != "camera"], 0.0)
    pictures = 0
    for a, b in zip(made, again, strict=True):
        _require_same(to, a, b)
        pairs = {"state": [(a.state, b.state)], "action": [(a.actions, b.actions)]}
        if calibrated:
            pairs["camera"] = [
                (getattr(camera, part), getattr(b.cameras[name], part))
                for name, camera in a.cameras.items()
                for part in ("K", "T_world_camera")
            ]
        for x, y in zip(a.frames(), b.frames(), strict=True):
            pictures += len(x.rgb)
            for what, (old, new) in {
                "colour": (x.rgb, y.rgb), "depth": (x.depth_m, y.depth_m),
            }.items():  # fmt: skip
                each = [(old[name], new[name]) for name in old]
                found[what] = max([found[what], *(_greatest(*pair) for pair in each)])
        for what, each in pairs.items():
            found[what] = max([found[what], *(_greatest(*pair) for pair in each)])
    compared = Compared(to, len(made), sum(e.num_frames for e in made), pictures, found)
    if any(found[what] > TOLERANCE[what] for what in found):
        raise DatasetError(f"not within tolerance: {compared}")
    return compared


def _require_same(to: str, made: Episode, again: Episode) -> None:
    """Raise unless rate, length, instruction, cameras, and the scene of a bag are the same."""
    facts = [
        (e.num_frames, e.hz, e.manifest.instruction, sorted(c.name for c in e.manifest.cameras))
        for e in (made, again)
    ]
    if facts[0] != facts[1] or (to == "rosbag2" and made.scene != again.scene):
        raise DatasetError(
            f"{to}: {made.folder}: expected {facts[0]} and its scene, got {facts[1]}"
        )


def _greatest(a: np.ndarray, b: np.ndarray) -> float:
    if a.shape != b.shape:
        raise DatasetError(f"expected shape {a.shape}, got {b.shape}")
    return float(np.abs(a.astype(np.float64) - b.astype(np.float64)).max(initial=0.0))


if __name__ == "__main__":
    print_measured(Options, measure)
