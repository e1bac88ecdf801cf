"""Proposals that an operator accepts or corrects: where a selection may come from."""

from __future__ import annotations

from collections.abc import Callable

from codediffuser.datagen.episode_format import SCENE
from codediffuser.errors import LabelError
from codediffuser.labeling.gui.draft import Selection
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.language import (
    Directions,
    Instance,
    InstanceProvider,
    ListedInstances,
    Vocabulary,
    ground,
    simulated_provider,
)
from codediffuser.registry import Registry

Prelabel = Callable[[EpisodeScene], Selection]

PRELABELS: Registry[Prelabel] = Registry("pre-label")


def propose(name: str, scene: EpisodeScene) -> Selection:
    """Ask a registered source for targets.

    Raises:
        NotRegisteredError: No such source.
        CodeDiffuserError: The source has no answer for this episode; the message says why.
    """
    selection = PRELABELS.get(name)(scene)
    for role, instance_id in selection:
        if scene.instance(instance_id) is None:
            raise LabelError(
                f"{name}: the {role} target '{instance_id}' is not among the instances shown"
            )
    return selection


@PRELABELS.add("ground truth")
def from_simulator(scene: EpisodeScene) -> Selection:
    """The targets that the demonstration was scripted for."""
    if scene.episode is None:
        raise LabelError(scene.problem)
    target = scene.episode.scene.target
    return (("pick", target.pick), ("place", target.place))


@PRELABELS.add("language")
def from_language(scene: EpisodeScene) -> Selection:
    """What a program written for the instruction finds."""
    return ground(scene.instruction, _provider(scene)).targets


def _provider(scene: EpisodeScene) -> InstanceProvider:
    """The scene file's things where there is one, for words may name more than can be chosen."""
    if scene.episode is None or scene.task is None:
        raise LabelError(scene.problem)
    if SCENE in scene.episode.manifest.files:
        return simulated_provider(scene.episode.scene)
    observer = scene.task.config.observer
    free = [i for i in scene.instances if not i.taken_by]
    return ListedInstances(
        [Instance(i.id, i.category, i.name, i.points_world) for i in free],
        {need.role: need.category for need in scene.needs},
        categories=[need.category for need in scene.needs],
        directions=Directions(observer.right, observer.front),
        vocabulary=Vocabulary.of(scene.task),
    )


@PRELABELS.add("features")
def from_features(scene: EpisodeScene) -> Selection:
    """Targets that need no choice: the only free instance of its role, as the source found it.

    Where several could be meant, the role stays open; perception does not know what was asked.
    """
    selection = []
    for need in scene.needs:
        free = [i for i in scene.instances if i.role in (need.role, None) and not i.taken_by]
        if len(free) == 1:
            selection.append((need.role, free[0].id))
    if not selection:
        raise LabelError("no role has only one instance, so features alone cannot choose")
    return tuple(selection)
