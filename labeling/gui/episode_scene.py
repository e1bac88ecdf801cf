"""One episode as the labeling window needs it, read once: instances, words, cloud, pictures."""

from __future__ import annotations

import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.datagen.episode import Episode, Frame
from codediffuser.datagen.episode_format import Camera
from codediffuser.datagen.task import Task, get_task
from codediffuser.errors import CodeDiffuserError, LabelError
from codediffuser.labeling.ground_truth import thin_points
from codediffuser.labeling.gui.draft import RoleNeed, Selection
from codediffuser.labeling.gui.picking import Picker, camera_picker, top_picker
from codediffuser.labeling.instances import InstanceSource, SelectableInstance
from codediffuser.labeling.label import AttentionLabel, Provenance
from codediffuser.pointcloud import farthest_point_indices

DRAWN_POINTS = 1200
"""Points of each instance that are drawn; clicks are judged by all of them."""

GAP_M = 0.0025
"""Drawn points keep that far from another instance's."""


@dataclass(frozen=True)
class EpisodeScene:
    """What is shown of one episode."""

    folder: Path
    episode: Episode | None
    """None when the folder is damaged; `problem` says why."""
    task: Task | None
    instances: tuple[SelectableInstance, ...]
    problem: str = ""
    """Why nothing can be chosen; empty when something can."""

    @property
    def id(self) -> str:
        """Id of the episode: the name of its folder."""
        return self.folder.name

    @property
    def instruction(self) -> str:
        """What the demonstration was asked to do; empty for a damaged episode."""
        return self.episode.manifest.instruction if self.episode else ""

    @property
    def needs(self) -> tuple[RoleNeed, ...]:
        """The task's roles, in order."""
        if self.task is None:
            return ()
        return (
            RoleNeed("pick", self.task.pick_category),
            RoleNeed("place", self.task.place_category),
        )

    @property
    def num_frames(self) -> int:
        """Frames that the time slider runs over, at least 1."""
        return self.episode.num_frames if self.episode else 1

    @functools.cached_property
    def cameras(self) -> Mapping[str, Camera]:
        """Cameras with depth that stand still; none for a damaged episode."""
        try:
            return self.episode.depth_cameras if self.episode else {}
        except CodeDiffuserError:
            return {}

    @functools.cached_property
    def start(self) -> Frame | None:
        """Pictures of frame 0; None when they cannot be read."""
        return self.frame(0)

    def frame(self, index: int) -> Frame | None:
        """Pictures of any frame; None when they cannot be read."""
        if self.episode is None or not self.cameras:
            return None
        try:
            return self.episode.frame(index, list(self.cameras))
        except CodeDiffuserError:
            return None

    @functools.cached_property
    def top(self) -> Picker:
        """The table from above, to click in."""
        return top_picker(self.instances)

    @functools.cached_property
    def clusters(self) -> tuple[np.ndarray, ...]:
        """Points (M, 3) of each instance to draw from above: thinned, neighbours kept apart.

        Slots of a crate share walls; without a gap they would look like one.
        """
        thin = [
            i.points_world[farthest_point_indices(i.points_world, DRAWN_POINTS)]
            for i in self.instances
        ]
        drawn = []
        for k, points in enumerate(thin):
            others = [p[:, :2] for j, p in enumerate(thin) if j != k]
            tree = cKDTree(np.concatenate([np.zeros((0, 2)), *others]))
            gap, _ = tree.query(points[:, :2], distance_upper_bound=GAP_M)
            apart = points[~np.isfinite(gap)]
            drawn.append(apart if len(apart) else points)
        return tuple(drawn)

    def through(self, camera: str) -> Picker:
        """One camera's picture of frame 0, to click in; kept once made."""
        if camera not in self._through:
            start = self.start
            depth_m = start.depth_m[camera] if start else np.zeros((1, 1), np.float32)
            self._through[camera] = camera_picker(self.instances, depth_m, self.cameras[camera])
        return self._through[camera]

    @functools.cached_property
    def _through(self) -> dict[str, Picker]:
        return {}

    def instance(self, instance_id: str) -> SelectableInstance | None:
        """The instance with an id; None when this source found no such one."""
        return next((i for i in self.instances if i.id == instance_id), None)

    def labels(self, selection: Selection, provenance: Provenance) -> tuple[AttentionLabel, ...]:
        """Turn a selection into labels.

        Raises:
            LabelError: A selected id is not among the instances.
        """
        labels = []
        for role, name in selection:
            found = self.instance(name)
            if found is None:
                raise LabelError(f"{self.folder}: there is no instance '{name}' to {role}")
            follows = found.follows if role == "pick" else None
            points = thin_points(found.points_world)
            labels.append(
                AttentionLabel(role, found.category, name, points, follows, provenance)
            )  # fmt: skip
        return tuple(labels)


def load_scene(folder: Path, source: InstanceSource) -> EpisodeScene:
    """Read an episode; whatever is wrong with it becomes `EpisodeScene.problem`."""
    try:
        episode = Episode.open(folder)
        task = _task(episode.manifest.task)
    except CodeDiffuserError as error:
        return EpisodeScene(folder, None, None, (), str(error))
    try:
        instances = source.instances(episode, task)
    except CodeDiffuserError as error:
        return EpisodeScene(folder, episode, task, (), str(error))
    problem = "" if instances else "the cameras show nothing to choose at frame 0"
    scene = EpisodeScene(folder, episode, task, instances, problem)
    # Made here, off the operator's path: the first click must not wait for it.
    _ = scene.top, scene.start, scene.clusters
    if task.config.labeling.view in scene.cameras:
        scene.through(task.config.labeling.view)
    return scene


@functools.lru_cache(maxsize=8)
def _task(name: str) -> Task:
    """A task read once for all episodes, and with it its bodies: see `ground_truth.py`."""
    return get_task(name)


class SceneCache:
    """Scenes that were opened last, and the next one read ahead.

    Args:
        load: Reads one episode folder.
        size: Scenes kept; about 10 MB each.
    """

    def __init__(self, load: Callable[[Path], EpisodeScene], size: int = 8) -> None:
        self._load, self._size = load, size
        self._scenes: OrderedDict[Path, Future[EpisodeScene]] = OrderedDict()
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="episode")

    def get(self, folder: Path) -> EpisodeScene:
        """The scene of a folder, waiting for it when it is being read."""
        return self.prefetch(folder).result()

    def prefetch(self, folder: Path) -> Future[EpisodeScene]:
        """Begin to read a folder that will be asked for soon."""
        with self._lock:
            if folder not in self._scenes:
                self._scenes[folder] = self._pool.submit(self._load, folder)
            self._scenes.move_to_end(folder)
            while len(self._scenes) > self._size:
                self._scenes.popitem(last=False)
            return self._scenes[folder]

    def close(self) -> None:
        """Stop reading ahead."""
        self._pool.shutdown(wait=False, cancel_futures=True)
