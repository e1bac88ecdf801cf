"""A browser window over the episodes of a run or a dataset: cloud, cameras, hand, time."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import numpy as np
import viser

from codediffuser.datasets.inspecting.episode_view import EpisodeView, Shelf, Shot, hand_path
from codediffuser.errors import CodeDiffuserError
from codediffuser.labeling.gui.pictures import PICK_RGB, PLACE_RGB

HOST = "127.0.0.1"
POINT_SIZE_M = 0.002
FRUSTUM_M = 0.05
NOTHING = Shot(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), {})
WAY_RGB, HAND_RGB = (60, 130, 220), (230, 60, 60)


class InspectApp:
    """Shows one episode at a time; every open tab shows the same.

    Args:
        shelf: The episodes.
        title: Shown above the controls.
        port: 0 takes a free one.
        first: Id of the episode that is shown first; None for the first of the shelf.
    """

    def __init__(
        self, shelf: Shelf, title: str, *, port: int = 8080, first: str | None = None
    ) -> None:
        self._shelf = shelf
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._view: EpisodeView | None = None
        self.shown = NOTHING
        """What is shown now."""
        self._pictures: dict[str, Any] = {}
        self._nodes: dict[str, Any] = {}
        self.server = viser.ViserServer(host=HOST, port=port, label=title, verbose=False)
        self.server.scene.set_up_direction("+z")
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.server.gui.main_panel.dock_right()
        self._build(first or shelf.ids[0])
        self.open(self._episode.value)
        threading.Thread(target=self._play_on, daemon=True, name="play").start()

    @property
    def url(self) -> str:
        """Where a browser finds the window."""
        return f"http://{HOST}:{self.server.get_port()}"

    @property
    def frame(self) -> int:
        """Number of the frame that is shown."""
        return int(self._frame.value)

    @property
    def message(self) -> str:
        """Sentence of the episode that is shown, or why there is none."""
        return str(self._title.value)

    def close(self) -> None:
        """Stop playing and serving."""
        self._closed.set()
        self.server.stop()

    def show(self, k: int) -> None:
        """Show another frame of the open episode."""
        with self._lock:
            self._frame.value = k
            self._draw()

    def _build(self, first: str) -> None:
        gui = self.server.gui
        self._episode: Any = gui.add_dropdown("episode", self._shelf.ids, initial_value=first)
        # Sentences come from people and models: a text field shows them as they are.
        self._title: Any = gui.add_text("says", "", disabled=True, multiline=True)
        self._frame: Any = gui.add_slider("frame", 0, 1, 1, 0)
        self._play: Any = gui.add_checkbox("play", False)
        self._speed: Any = gui.add_dropdown(
            "speed", ("0.25x", "0.5x", "1x", "2x"), initial_value="1x"
        )
        self._poses: Any = gui.add_checkbox("camera poses", True)
        self._facts: Any = gui.add_markdown("")
        self._cameras: Any = gui.add_folder("cameras")
        # Changes that come from here, and from no browser, have been drawn already.
        self._episode.on_update(
            lambda event: self.open(self._episode.value) if event.client else None
        )
        self._poses.on_update(lambda _: self._show_poses())
        self._frame.on_update(lambda event: self._draw() if event.client else None)

    def open(self, name: str) -> None:
        """Change to another episode; one that cannot be read leaves its message in place of it."""
        with self._lock, self.server.atomic():
            self._clear()
            self._episode.value = name
            try:
                self._view = self._shelf.open(name)
            except CodeDiffuserError as error:
                self._title.value = str(error)
                return
            self._title.value = self._view.title
            self._frame.max = max(1, len(self._view.state) - 1)
            self._frame.value = 0
            self._add_cameras(self._view)
            self._add_way(self._view)
            self._draw(look=True)

    def _clear(self) -> None:
        for node in (*self._nodes.values(), *self._pictures.values()):
            node.remove()
        self._nodes, self._pictures, self._view = {}, {}, None

    def _keep(self, node: Any) -> None:
        """Remember a node of this episode; one of the same name has taken the older one's place."""
        self._nodes[node.name] = node

    def _add_cameras(self, view: EpisodeView) -> None:
        for name, camera in view.cameras.items():
            pose = viser.transforms.SE3.from_matrix(camera.T_world_camera)
            fov = 2 * math.atan(camera.height / 2 / camera.K[1, 1])
            self._keep(
                self.server.scene.add_camera_frustum(
                    f"/cameras/{name}", fov=fov, aspect=camera.width / camera.height,
                    scale=FRUSTUM_M, thickness=1.5, thickness_units="screen",
                    visible=self._poses.value, wxyz=pose.rotation().wxyz,
                    position=pose.translation(),
                )
            )  # fmt: skip

    def _show_poses(self) -> None:
        with self._lock:
            for name, node in self._nodes.items():
                if name.startswith("/cameras/"):
                    node.visible = self._poses.value

    def _add_way(self, view: EpisodeView) -> None:
        way = hand_path(view)
        if len(way) < 2:
            return
        pieces = np.stack([way[:-1], way[1:]], axis=1)
        self._keep(
            self.server.scene.add_line_segments(
                "/hand/way", pieces, WAY_RGB, thickness=2, thickness_units="screen"
            )
        )
        self._keep(self.server.scene.add_icosphere("/hand/now", radius=0.008, color=HAND_RGB))

    def _draw(self, *, look: bool = False) -> None:
        """Show the frame of the slider; `look` also turns the view to it."""
        with self._lock, self.server.atomic():
            if self._view is None:
                return
            k = min(self.frame, len(self._view.state) - 1)
            try:
                shot = self._view.shot(k)
            except CodeDiffuserError as error:
                self._title.value = str(error)
                return
            self.shown = shot
            self._keep(
                self.server.scene.add_point_cloud(
                    "/cloud", shot.points_world, shot.rgb, point_size=POINT_SIZE_M,
                    point_shape="circle", point_shading="flat", precision="float32",
                )
            )  # fmt: skip
            if "/hand/now" in self._nodes:
                self._nodes["/hand/now"].position = hand_path(self._view)[k]
            self._show_pictures(shot.pictures)
            self._facts.content = self._facts_text(k, shot.rgb)
            if look and len(shot.points_world):
                self._look_at(shot.points_world)

    def _show_pictures(self, pictures: Any) -> None:
        for name, picture in pictures.items():
            if name in self._pictures:
                self._pictures[name].image = picture
            else:
                with self._cameras:
                    self._pictures[name] = self.server.gui.add_image(picture, label=name)

    def _facts_text(self, k: int, rgb: np.ndarray) -> str:
        assert self._view is not None
        counts = [int((rgb == color).all(axis=1).sum()) for color in (PICK_RGB, PLACE_RGB)]
        return (
            f"{k / self._view.hz:.2f} s · {len(rgb)} points · orange to pick: {counts[0]} · "
            f"green to place: {counts[1]}"
        )

    def _look_at(self, points: np.ndarray) -> None:
        low, high = np.quantile(points, [0.02, 0.98], axis=0)
        middle, reach = (low + high) / 2, float(np.linalg.norm((high - low)[:2]))
        camera = self.server.initial_camera
        camera.position = tuple(middle + reach * np.array([0.5, 1.0, 0.9]))
        camera.look_at = tuple(middle)
        camera.up = (0.0, 0.0, 1.0)

    def _play_on(self) -> None:
        shown = time.monotonic()
        while not self._closed.wait(0.02):
            view, now = self._view, time.monotonic()
            if view is None or not self._play.value:
                shown = now
                continue
            # A slow machine shows fewer frames, never a slower motion.
            rate = view.hz * float(self._speed.value.rstrip("x"))
            if steps := int((now - shown) * rate):
                shown += steps / rate
                self.show((self.frame + steps) % max(1, len(view.state)))
