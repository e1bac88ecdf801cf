"""What a policy sees at one moment of a rollout, made as `convert` makes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.datagen.views import Moment, MomentView
from codediffuser.datasets.clouds import CloudConfig, View, cloud_rng, policy_cloud
from codediffuser.labeling.attention import AttentionField
from codediffuser.pointcloud import crop_box, fuse_views

if TYPE_CHECKING:
    from codediffuser.datagen.rendering import Frame, Renderer


def object_poses(
    scene: SceneSpec, object_ids: Sequence[str], moment: Moment
) -> dict[str, np.ndarray]:
    """Pose (4, 4) float64 of every movable object, by id."""
    view = MomentView(scene, object_ids, moment)
    return {name: view.T_world_object(name) for name in object_ids}


def depth_views(renderer: Renderer, frames: Mapping[str, Frame]) -> list[View]:
    """Depth pictures with their calibration, in the order of the cameras."""
    return [View(frames[name].depth_m, K, T) for name, (K, T) in renderer.parameters.items()]


def workspace_cloud(task: Task, views: Sequence[View]) -> np.ndarray:
    """Points (N, 3) float32 that the cameras see in the workspace: what frame-0 labels name."""
    box = task.config.workspace
    return crop_box(fuse_views(views), np.array(box.low_m), np.array(box.high_m))


class Observer:
    """Makes the observations of one rollout.

    Args:
        task: Gives the workspace.
        scene: What was reset to; its number addresses the clouds' generators.
        object_ids: Order of a moment's object rows.
        renderer: Draws the cameras; `scene` must be set.
        field: Where attention lies, carried by the objects' true poses.
        config: Sizes of the cloud: those of the policy's dataset.
        corrupt_share: Share of attended points swapped for wrong ones (stress test).
    """

    def __init__(
        self,
        task: Task,
        scene: SceneSpec,
        object_ids: Sequence[str],
        renderer: Renderer,
        field: AttentionField,
        config: CloudConfig,
        *,
        corrupt_share: float = 0.0,
    ) -> None:
        self._scene, self._object_ids, self._renderer = scene, tuple(object_ids), renderer
        self._field, self._config, self._corrupt_share = field, config, corrupt_share
        box = task.config.workspace
        self._low_m, self._high_m = np.array(box.low_m), np.array(box.high_m)

    def views(self, moment: Moment) -> list[View]:
        """Draw the depth pictures of all cameras."""
        return depth_views(self._renderer, self._renderer.render(moment))

    def cloud(self, moment: Moment, views: Sequence[View], step: int) -> np.ndarray:
        """The policy cloud (N, 5) float32 of one control step."""
        seed = self._scene.seed
        return policy_cloud(
            views,
            self._field,
            object_poses(self._scene, self._object_ids, moment),
            MomentView(self._scene, self._object_ids, moment).T_world_hand(),
            self._low_m,
            self._high_m,
            cloud_rng(seed.root, seed.index, step),
            self._config,
            corrupt_share=self._corrupt_share,
        )
