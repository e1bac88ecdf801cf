"""Judges instances found by features on simulated scenes that nothing was trained on.

`python -m codediffuser.labeling.perception.evaluate` prints, for each task, precision and recall of
its instances, how often 3D attention is right, and which scenes fail and why.

An instance is right when it shares more than half of the points of both together with a true one
of its category (intersection over union above 0.5), each true one once. True are all objects and
places that the cameras show at least 20 points of: those that are put away too. Attention is right
when both the object's and the place's Chamfer distance to the ground-truth label is within 0.005 m:
the mean distance from each point to the nearest of the other cloud, not squared, both ways, mean of
the two ways (`agreement.chamfer_m`). The instance is chosen by the target's true points.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.optimize import linear_sum_assignment

from codediffuser.datagen.randomization import load_randomization
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import Task, get_task
from codediffuser.errors import BelowTargetError, LabelError
from codediffuser.files import atomic_path
from codediffuser.labeling.agreement import chamfer_m
from codediffuser.labeling.ground_truth import (
    GroundTruthConfig,
    ground_truth_labels,
    object_points,
    place_points,
    thin_points,
)
from codediffuser.labeling.perception.cloud import CloudFuser
from codediffuser.labeling.perception.finding import FoundInstance
from codediffuser.labeling.perception.instances import FeaturesSource, selectable
from codediffuser.labeling.perception.overlay import found_overlay
from codediffuser.labeling.perception.rendered import StartRenderer, StartScene, seen_places
from codediffuser.pointcloud import crop_box, fuse_views
from codediffuser.seeding import Stage

MIN_IOU = 0.5
MAX_CHAMFER_M = 0.005
MIN_RATE = 0.98
"""Precision and recall that are asked for."""
MIN_ATTENTION = {"hang_mug": 0.97, "pack_battery": 0.94}
"""Share of scenes with right attention that is asked for."""


@dataclass(frozen=True, slots=True)
class TrueInstance:
    """One object or place as the simulator knows it."""

    id: str
    category: str
    points_world: np.ndarray


@dataclass(frozen=True, slots=True)
class SceneScore:
    """What became of one scene."""

    scene_id: str
    right: Counter[str]
    """Instances found right, by category."""
    found: Counter[str]
    true: Counter[str]
    chamfer_m: tuple[float, float]
    """Of the object and of the place; infinite when there is nothing to choose."""
    faults: tuple[str, ...]
    """What went wrong, in words."""

    @property
    def attention(self) -> bool:
        """Whether attention is right."""
        return max(self.chamfer_m) <= MAX_CHAMFER_M


def score_scenes(
    task: Task,
    indices: Sequence[int],
    *,
    root_seed: int = 0,
    randomize: str | None = None,
    pictures: Path | None = None,
) -> Iterator[SceneScore]:
    """Draw evaluation scenes and judge what the `features` source finds in them.

    Args:
        task: Whose scenes.
        indices: Numbers of the scenes.
        root_seed: Of the scenes; they come from `Stage.EVAL_SCENE`, which nothing trains on.
        randomize: Preset of domain randomisation; None is the usual look.
        pictures: Folder for a picture of the first scene and of each with a fault.

    Raises:
        SetupError: There is no usable Vulkan device, or the network's weights are missing.
    """
    renderer, source = StartRenderer(task), FeaturesSource()
    ranges = load_randomization(randomize) if randomize else None
    for index in indices:
        scene = sample_scene(task, root_seed=root_seed, index=index, stage=Stage.EVAL_SCENE)
        start = renderer.draw(scene, ranges)
        found = source.found(start.views, task)
        score = judge(task, start, found)
        if pictures is not None and (score.faults or index == indices[0]):
            with atomic_path(pictures / f"{task.name}_{scene.scene_id}.png") as partial:
                found_overlay(start.views, found).save(partial)
        yield score


def judge(task: Task, start: StartScene, found: Sequence[FoundInstance]) -> SceneScore:
    """Compare what was found in a scene with what is there."""
    true = true_instances(task, start)
    shared = np.array([[_iou(t, f) for f in found] for t in true]).reshape(len(true), len(found))
    rows, columns = linear_sum_assignment(-shared)
    pairs = [(r, c) for r, c in zip(rows, columns, strict=True) if shared[r, c] > MIN_IOU]
    matched = {true[r].id: found[c] for r, c in pairs}
    spurious = sorted(set(range(len(found))) - {c for _, c in pairs})
    faults = [
        f"{t.id} not found (best overlap {shared[r].max(initial=0):.2f} of its "
        f"{len(t.points_world)} points)"
        for r, t in enumerate(true)
        if t.id not in matched
    ]
    faults += [
        f"a {found[c].category} of {len(found[c].points_world)} points where none is, at "
        f"{np.round(found[c].middle_world, 3).tolist()}"
        for c in spurious
    ]
    distances = _attention(task, start, matched, faults)
    faults += _misjudged(task, start, found, matched)
    return SceneScore(
        start.scene.scene_id,
        Counter(f.category for f in matched.values()),
        Counter(f.category for f in found),
        Counter(t.category for t in true),
        distances,
        tuple(faults),
    )


def true_instances(task: Task, start: StartScene) -> tuple[TrueInstance, ...]:
    """All objects and places of the task's categories that the cameras show enough of."""
    box, scene, T = task.config.workspace, start.scene, start.T_world_start
    cloud = CloudFuser(box.low_m, box.high_m).fuse(start.views).points_world
    margin_m, least = GroundTruthConfig().margin_m, GroundTruthConfig().min_points
    true = [
        TrueInstance(o.id, o.category, object_points(task, scene, o, T, cloud, margin_m))
        for o in scene.objects
        if o.category == task.pick_category
    ]
    true += [
        TrueInstance(p.id, p.category, place_points(task, scene, p, T, cloud, margin_m))
        for p in seen_places(task, scene)
    ]
    return tuple(t for t in true if len(t.points_world) >= least)


def _iou(true: TrueInstance, found: FoundInstance) -> float:
    """Shared points of all points; both are parts of one cloud, so shared ones are equal."""
    low = np.maximum(true.points_world.min(axis=0), found.points_world.min(axis=0))
    high = np.minimum(true.points_world.max(axis=0), found.points_world.max(axis=0))
    if true.category != found.category or (low > high).any():
        return 0.0
    both = np.unique(np.concatenate([true.points_world, found.points_world]), axis=0)
    total = len(true.points_world) + len(found.points_world)
    return (total - len(both)) / len(both)


def _attention(
    task: Task, start: StartScene, matched: dict[str, FoundInstance], faults: list[str]
) -> tuple[float, float]:
    box = task.config.workspace
    views = [(v.depth_m, v.camera.K, v.camera.T_world_camera) for v in start.views]
    cloud = crop_box(fuse_views(views), np.array(box.low_m), np.array(box.high_m))
    try:
        labels = ground_truth_labels(task, start.scene, start.T_world_start, cloud)
    except LabelError as error:
        faults.append(f"no ground truth: {error}")
        return (float("inf"), float("inf"))
    distances = []
    for label in labels:
        found = matched.get(label.instance_id)
        far = float("inf")
        if found is not None:
            far = chamfer_m(thin_points(found.points_world), label.points_world)
        if found is not None and far > MAX_CHAMFER_M:
            faults.append(f"attention on {label.instance_id} is {1e3 * far:.1f} mm off")
        distances.append(far)
    return (distances[0], distances[1])


def _misjudged(
    task: Task,
    start: StartScene,
    found: Sequence[FoundInstance],
    matched: dict[str, FoundInstance],
) -> Iterator[str]:
    """Objects and places that are shown as free and are not, or the reverse."""
    offered = {id(s.points_world): s for s in selectable(found, task)}
    waiting = {o.id for o in start.scene.pickable}
    free = {p.id for p in start.scene.free_places}
    for name, instance in matched.items():
        shown = offered.get(id(instance.points_world))
        is_free = shown is not None and not shown.taken_by
        if is_free != (name in waiting or name in free):
            yield f"{name} is taken for {'free' if is_free else 'put away or taken'}"


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Options of the command."""

    tasks: tuple[str, ...] = ("hang_mug", "pack_battery", "stow_book")
    scenes: int = 200
    """Of each task."""
    first: int = 0
    """Number of the first one."""
    seed: int = 0
    """Root seed of the evaluation scenes."""
    randomize: str | None = None
    """Preset of domain randomisation, such as `mild`; the usual look without it."""
    pictures: Path | None = None
    """Folder for a picture of the first scene of each task, and of each with a fault."""


def report(task: Task, scores: Sequence[SceneScore]) -> tuple[list[str], bool]:
    """Lines to print, and whether everything that is asked for is reached."""
    lines, reached = [], True
    for category in (task.pick_category, task.place_category):
        right, found, true = (
            sum(c[category] for c in counts)
            for counts in zip(*((s.right, s.found, s.true) for s in scores), strict=True)
        )
        precision, recall = right / max(found, 1), right / max(true, 1)
        reached &= min(precision, recall) >= MIN_RATE
        lines.append(
            f"{task.name} {category}: precision {precision:.4f} ({right} of {found} found), "
            f"recall {recall:.4f} ({right} of {true} true), asked {MIN_RATE}"
        )
    good = sum(s.attention for s in scores)
    asked = MIN_ATTENTION.get(task.name, 0.0)
    reached &= good >= asked * len(scores)
    known = [m for s in scores for m in s.chamfer_m if np.isfinite(m)] or [np.inf]
    lines.append(
        f"{task.name} attention: {good} of {len(scores)} scenes within {MAX_CHAMFER_M} m "
        f"({good / len(scores):.3f}, asked {asked or 'nothing'}); Chamfer median "
        f"{np.median(known) * 1e3:.2f} mm, 99th percentile {np.percentile(known, 99) * 1e3:.2f} mm"
    )
    lines += [f"  scene {s.scene_id}: {'; '.join(s.faults)}" for s in scores if s.faults]
    return lines, reached


def main() -> None:
    """Print the evaluation; exit with 3 when something that is asked for is missed."""
    options = tyro.cli(Evaluation)
    reached = True
    for name in options.tasks:
        task = get_task(name)
        scores = list(
            score_scenes(
                task,
                range(options.first, options.first + options.scenes),
                root_seed=options.seed,
                randomize=options.randomize,
                pictures=options.pictures,
            )
        )
        lines, ok = report(task, scores)
        sys.stdout.write("\n".join(lines) + "\n")
        reached &= ok
    if not reached:
        sys.exit(BelowTargetError.exit_code)


if __name__ == "__main__":
    main()
