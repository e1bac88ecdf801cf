"""A folder of scenes: YAML and reset pictures each; pictures and a summary of the whole set."""

from __future__ import annotations

import functools
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from codediffuser.datagen.reset_image import save_pictures
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import SceneSource
from codediffuser.datagen.scene_summary import SUMMARY_FILE, SampleSummary, SummaryBuilder
from codediffuser.datagen.sheets.pads_pdf import Paper
from codediffuser.datagen.sheets.set_pictures import SetPictures
from codediffuser.errors import ConfigError
from codediffuser.files import remove_partials


def sample_scenes(
    source: SceneSource,
    out: Path,
    count: int,
    *,
    pictures: bool = True,
    paper: Paper = "A4",
    workers: int = 1,
    overwrite: bool = False,
) -> Iterator[Path]:
    """Write `out/000000.yaml`, `.png` and `.svg`, ... and yield each YAML's path once it is there.

    Pictures of the whole set (`overlay.png`, `sheet.pdf`, `pads.pdf`) follow, and
    `out/summary.json` comes last. Files are written whole or not at all. Scenes that are already
    there are kept, so running again goes on where an earlier run was stopped; `overwrite` draws
    them anew.

    Args:
        source: What to draw, and by which settings.
        out: Folder; made when missing.
        count: How many scenes.
        pictures: Whether to draw pictures.
        paper: What `pads.pdf` is printed on.
        workers: Processes; changes nothing but the time.
        overwrite: Draw scenes anew that are already there.

    Raises:
        ConfigError: The folder holds scenes of another task or other settings.
        PlacementError: As for `SceneSource.draw`.
        InstructionError: As for `SceneSource.draw`.
    """
    out.mkdir(parents=True, exist_ok=True)
    remove_partials(out)
    if not overwrite:
        _check_same_settings(source, out)
    (out / SUMMARY_FILE).unlink(missing_ok=True)
    write = functools.partial(_write_scene, source, out, pictures, overwrite)
    summary = SummaryBuilder(source.task, source.settings, source.library)
    drawn = SetPictures(source.task, source.settings.variant, source.settings.root_seed, paper)
    for path, scene in _run(write, count, workers):
        summary.add(scene)
        if pictures:
            drawn.add(scene)
        yield path
    if pictures:
        drawn.save(out)
    summary.finish().save(out / SUMMARY_FILE)


def _run(
    write: functools.partial[tuple[Path, SceneSpec]], count: int, workers: int
) -> Iterator[tuple[Path, SceneSpec]]:
    if workers <= 1:
        yield from map(write, range(count))
        return
    # Forked children could inherit locks of threads (OpenMP, torch) in the middle of something.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield from pool.map(write, range(count), chunksize=max(1, min(64, count // workers)))


def _write_scene(
    source: SceneSource, out: Path, pictures: bool, overwrite: bool, index: int
) -> tuple[Path, SceneSpec]:
    """Write one scene and its picture unless both are there."""
    path, picture = out / f"{index:06d}.yaml", out / f"{index:06d}.png"
    if path.exists() and not overwrite:
        scene = SceneSpec.load(path)
        _check_same_run(scene, source, path)
    else:
        # The picture goes first and comes back last: one that is there belongs to its YAML.
        picture.unlink(missing_ok=True)
        scene = source.draw(index)
        scene.save(path)
    if pictures and not picture.exists():
        save_pictures(source.task.draw_reset(scene), picture)
    return path, scene


def _check_same_settings(source: SceneSource, out: Path) -> None:
    """Refuse to go on with a finished set that was drawn by other settings."""
    if not (out / SUMMARY_FILE).exists():
        return
    earlier = SampleSummary.load(out / SUMMARY_FILE).settings
    for key in SamplingSettings.model_fields:
        before, now = getattr(earlier, key), getattr(source.settings, key)
        if before != now:
            _refuse(out / SUMMARY_FILE, "scenes", key, before, now)


def _check_same_run(scene: SceneSpec, source: SceneSource, path: Path) -> None:
    """Refuse to mix scenes that were drawn by other settings into a run."""
    asked = source.settings
    compared = {
        "task": (source.task.name, scene.task),
        "seed": (asked.root_seed, scene.seed.root),
        "stage": (asked.stage, scene.seed.stage),
        "variant": (asked.variant, scene.variant),
        "split": (asked.split, scene.split),
        "template_split": (asked.template_split, scene.instruction.template_split),
        "picks": (asked.picks, scene.ambiguity.picks),
        "places": (asked.places, scene.ambiguity.places),
    }
    for key, (expected, found) in compared.items():
        if expected is not None and expected != found:
            _refuse(path, "a scene", key, found, expected)


def _refuse(path: Path, what: str, key: str, found: object, expected: object) -> None:
    raise ConfigError(
        f"{path}: holds {what} with {key} {found}, expected {expected}; choose another --out, or "
        "--overwrite"
    )
