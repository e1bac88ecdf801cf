"""Initial configurations: objects, places, a target, and an instruction that fits them.

Needs no simulator. Each scene comes from its own address (`codediffuser.seeding`), so neither the
number of workers nor the order nor earlier scenes change any of its bytes.
"""

from __future__ import annotations

import functools
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from codediffuser.datagen.instructions.generator import check_instruction, make_instruction
from codediffuser.datagen.instructions.templates import TemplateLibrary
from codediffuser.datagen.reset_image import save_png
from codediffuser.datagen.scene import Ambiguity, SceneSpec, SeedKey, Split, Target
from codediffuser.datagen.task import Layout, Task
from codediffuser.errors import ConfigError, InstructionError, PlacementError
from codediffuser.files import remove_partials
from codediffuser.seeding import Stage, rng_for

MAX_ATTEMPTS = 50
"""Layouts that are drawn for one scene before it is given up; the first serves nearly always."""


def sample_scene(
    task: Task,
    *,
    root_seed: int,
    index: int,
    stage: Stage = Stage.SCENE,
    split: Split = "train",
    variant: str = "sim",
    picks: int | None = None,
    places: int | None = None,
    library: TemplateLibrary | None = None,
) -> SceneSpec:
    """Draw one scene.

    Args:
        task: What to draw.
        root_seed: Seed of the whole run, >= 0.
        index: Number of the scene, >= 0; also its id.
        stage: Keeps scenes for different uses apart: `Stage.SCENE` or `Stage.EVAL_SCENE`.
        split: Name that is written into the scene.
        variant: Which ranges of the task's YAML to draw from.
        picks: How many objects can be picked; None draws it.
        places: How many places are free; None draws it.
        library: Sentences; None takes those that ship.

    Raises:
        PlacementError: Objects find no room; the message names the key to change.
        InstructionError: No sentence fits any of `MAX_ATTEMPTS` layouts.
        ConfigError: An argument or the library does not fit the task.
    """
    reason = ""
    for attempt in range(MAX_ATTEMPTS):
        rng = rng_for(root_seed, stage, index, attempt)
        try:
            layout = task.sample_layout(rng, variant=variant, picks=picks, places=places)
        except PlacementError as error:
            raise PlacementError(f"{task.name}, scene {index:06d}: {error}") from None
        target = _draw_target(layout, rng)
        try:
            instruction = make_instruction(task, layout, target, rng, library)
        except InstructionError as error:
            reason = str(error)
            continue
        scene = SceneSpec(
            task=task.name,
            variant=variant,
            scene_id=f"{index:06d}",
            seed=SeedKey(root=root_seed, stage=stage.name, index=index, attempt=attempt),
            split=split,
            objects=layout.objects,
            places=layout.places,
            target=target,
            ambiguity=Ambiguity(picks=len(layout.pickable), places=len(layout.free_places)),
            instruction=instruction,
        )
        check_instruction(scene, task)
        return scene
    raise InstructionError(
        f"{task.name}, scene {index:06d}: no instruction in {MAX_ATTEMPTS} layouts; last: {reason}"
    )


def _draw_target(layout: Layout, rng: np.random.Generator) -> Target:
    """One waiting object and one free place, evenly."""
    pick = layout.pickable[rng.integers(len(layout.pickable))]
    place = layout.free_places[rng.integers(len(layout.free_places))]
    return Target(pick=pick.id, place=place.id)


def sample_scenes(
    task: Task,
    out: Path,
    count: int,
    root_seed: int,
    *,
    stage: Stage = Stage.SCENE,
    split: Split = "train",
    variant: str = "sim",
    picks: int | None = None,
    places: int | None = None,
    library: TemplateLibrary | None = None,
    workers: int = 1,
    overwrite: bool = False,
) -> Iterator[Path]:
    """Write `out/000000.yaml`, `out/000000.png`, ... and yield each YAML's path once it is there.

    Files are written whole or not at all. Scenes that are already there are kept, so running again
    goes on where an earlier run was stopped; `overwrite` draws them anew.

    Args:
        task: What to draw.
        out: Folder; made when missing.
        count: How many scenes.
        root_seed: Seed of the whole run, >= 0.
        stage: As for `sample_scene`, like the arguments up to `library`.
        split: See there.
        variant: See there.
        picks: See there.
        places: See there.
        library: See there.
        workers: Processes; changes nothing but the time.
        overwrite: Draw scenes anew that are already there.

    Raises:
        ConfigError: The folder holds scenes of another task, seed or variant.
        PlacementError: As for `sample_scene`.
        InstructionError: As for `sample_scene`.
    """
    out.mkdir(parents=True, exist_ok=True)
    remove_partials(out)
    draw = functools.partial(
        sample_scene, task, root_seed=root_seed, stage=stage, split=split, variant=variant,
        picks=picks, places=places, library=library,
    )  # fmt: skip
    write = functools.partial(_write_scene, draw, task, out, overwrite)
    if workers <= 1:
        yield from map(write, range(count))
        return
    # Forked children could inherit locks of threads (OpenMP, torch) in the middle of something.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield from pool.map(write, range(count), chunksize=max(1, min(16, count // workers)))


def _write_scene(
    draw: functools.partial[SceneSpec], task: Task, out: Path, overwrite: bool, index: int
) -> Path:
    """Write one scene and its picture unless both are there; return the YAML's path."""
    path, picture = out / f"{index:06d}.yaml", out / f"{index:06d}.png"
    if path.exists() and not overwrite:
        scene = SceneSpec.load(path)
        _check_same_run(scene, draw, path)
    else:
        # The picture goes first and comes back last: one that is there belongs to its YAML.
        picture.unlink(missing_ok=True)
        scene = draw(index=index)
        scene.save(path)
    if not picture.exists():
        save_png(task.draw_reset(scene), picture)
    return path


def _check_same_run(scene: SceneSpec, draw: functools.partial[SceneSpec], path: Path) -> None:
    """Refuse to mix scenes that were drawn by other settings into a run."""
    asked = draw.keywords
    settings = {
        "task": (draw.args[0].name, scene.task),
        "seed": (asked["root_seed"], scene.seed.root),
        "stage": (asked["stage"].name, scene.seed.stage),
        "variant": (asked["variant"], scene.variant),
        "split": (asked["split"], scene.split),
        "picks": (asked["picks"], scene.ambiguity.picks),
        "places": (asked["places"], scene.ambiguity.places),
    }
    for key, (expected, found) in settings.items():
        if expected is not None and expected != found:
            raise ConfigError(
                f"{path}: holds a scene with {key} {found}, expected {expected}; choose another "
                "--out, or --overwrite"
            )
