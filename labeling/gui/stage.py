"""Which view of an episode a tab shows, and what a place in it means."""

from __future__ import annotations

import numpy as np

from codediffuser.labeling.gui.draft import Selection
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.views import (
    CameraView,
    ClientHandle,
    CloudView,
    TopView,
    View,
    show_viewpoint,
)
from codediffuser.labeling.instances import SelectableInstance


class Stage:
    """The large part of one tab's window. An operator's choice of view outlives the episode.

    Args:
        client: The tab.
    """

    def __init__(self, client: ClientHandle) -> None:
        self._client = client
        self._kind, self._camera = "", 0
        self._scene: EpisodeScene | None = None
        self._view: View | None = None

    @property
    def cloud(self) -> CloudView | None:
        """The 3D view; None while another one is shown."""
        return self._view if isinstance(self._view, CloudView) else None

    @property
    def photo(self) -> CameraView | None:
        """The picture of a camera; None while another view is shown."""
        return self._view if isinstance(self._view, CameraView) else None

    @property
    def selects(self) -> bool:
        """Whether targets can be chosen in the view; 3D is only looked at."""
        return self._view is not None and self._view.plane is not None

    def show(self, scene: EpisodeScene | None, selection: Selection) -> None:
        """Show another episode, in the view that its task names unless the operator chose one."""
        self._scene = scene
        if scene is not None and self._kind in ("", "3d"):
            wanted = scene.task.config.labeling.view if scene.task else "top"
            self._kind = "camera" if wanted in scene.cameras else "top"
            if self._kind == "camera":
                self._camera = list(scene.cameras).index(wanted)
        self._build(selection)

    def switch(self, kind: str, selection: Selection) -> None:
        """Show `top`, `camera` or `3d`; `camera` again is the next camera."""
        self._camera += kind == "camera" and self._kind == "camera"
        self._kind = kind
        self._build(selection)

    def recolor(self, selection: Selection) -> None:
        """Show which instances are selected."""
        if self._view is not None:
            self._view.recolor(selection)

    def reset(self) -> None:
        """Put the browser's camera back to where all is seen."""
        if self._view is not None:
            show_viewpoint(self._client, self._view.viewpoint(self._client.camera.aspect))

    def pick(self, origin: np.ndarray, direction: np.ndarray) -> SelectableInstance | None:
        """The instance that a click with this ray (3,), (3,) means; None for no one."""
        view = self._view
        if view is None or view.plane is None or view.picker is None:
            return None
        return view.picker.nearest(view.plane.from_ray(origin, direction))

    def inside(self, origin: np.ndarray, *rays: np.ndarray) -> list[SelectableInstance]:
        """Instances of the box that rays (3,) through two opposite corners span."""
        view = self._view
        if view is None or view.plane is None or view.picker is None:
            return []
        corners = np.stack([view.plane.from_ray(origin, ray) for ray in rays])
        return view.picker.inside(corners.min(axis=0), corners.max(axis=0))

    def _build(self, selection: Selection) -> None:
        scene = self._scene
        with self._client.atomic():
            if self._view is not None:
                self._view.remove()
                self._view = None
            if scene is not None and scene.task is not None:
                self._view = self._make(scene)
                self._view.recolor(selection)
        self.reset()

    def _make(self, scene: EpisodeScene) -> View:
        if self._kind == "camera" and scene.cameras:
            names = list(scene.cameras)
            return CameraView(self._client, scene, names[self._camera % len(names)])
        return CloudView(self._client, scene) if self._kind == "3d" else TopView(
            self._client, scene
        )  # fmt: skip
