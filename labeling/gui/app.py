"""The labeling server: one viser server, one `Tab` per browser tab, one thread per tab.

Events of a tab are done in their order by the tab's own thread; what the browser shows first is
the recoloured instance, then the action goes to disk, then the panel says that it is saved.
"""

from __future__ import annotations

import hmac
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import numpy as np
import viser

from codediffuser.errors import CodeDiffuserError, ConfigError
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.keys import Action
from codediffuser.labeling.gui.panels import Panel, PanelCalls, ask_token
from codediffuser.labeling.gui.pictures import MovingAttention, camera_sheet, colored_cloud
from codediffuser.labeling.gui.planes import screen_ray
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.gui.views import CameraView, CloudView, TopView, View, show_viewpoint
from codediffuser.labeling.index import Filter
from codediffuser.labeling.instances import SelectableInstance
from codediffuser.labeling.leases import LEASE_S
from codediffuser.poses import quat_wxyz_to_matrix

logger = logging.getLogger(__name__)

LOCAL_HOST = "127.0.0.1"
SHEET_WAIT_S = 0.15
"""Camera pictures follow a click after so long without another one."""

PLAY_HZ = 8.0
MIN_TOKEN = 8
WRONG_TOKEN_S = 1.0


class LocalServer(viser.ViserServer):
    """A viser server that no client can open to the internet."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: viser would open a public tunnel for whoever asks."""
        logger.warning("a client asked for a public share link; refused")
        return None


class LabelApp:
    """Serves the labeling window.

    Args:
        desk: The run.
        operator: Proposed name of the operator.
        host: Address to listen at. Any but the own machine requires a token.
        port: Port; 0 takes a free one.
        token: What operators must enter; None lets everybody in who reaches the address.

    Raises:
        ConfigError: Another host without a token, or a token that is too short.
    """

    def __init__(
        self,
        desk: Desk,
        *,
        operator: str,
        host: str = LOCAL_HOST,
        port: int = 8080,
        token: str | None = None,
    ) -> None:
        check_access(host, token)
        self.desk, self._operator, self._token = desk, operator, token
        self.server = LocalServer(host=host, port=port, label="codediffuser", verbose=False)
        self.server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(230, 90, 0)
        )
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(430)
        self.tabs: dict[int, Tab] = {}
        self.server.on_client_connect(self._connect)
        self.server.on_client_disconnect(self._disconnect)
        self._closing = threading.Event()
        threading.Thread(target=self._renew_leases, daemon=True).start()

    @property
    def url(self) -> str:
        """Where to point the browser."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving; everything is on disk already."""
        self._closing.set()
        for tab in list(self.tabs.values()):
            tab.close()
        self.server.stop()
        self.desk.close()

    def _connect(self, client: viser.ClientHandle) -> None:
        name = _stored(client, "operator") or self._operator
        if self._token is None:
            self._admit(client, name)
            return

        def answer(token: str, operator: str) -> bool:
            right = hmac.compare_digest(token.encode(), cast(str, self._token).encode())
            if not right:
                time.sleep(WRONG_TOKEN_S)
            if not right or not operator.strip():
                return False
            client.local_storage.set_item("operator", operator.strip())
            self._admit(client, operator)
            return True

        ask_token(client, answer, name)

    def _admit(self, client: viser.ClientHandle, operator: str) -> None:
        self.tabs[client.client_id] = Tab(client, Session(self.desk, operator))

    def _disconnect(self, client: viser.ClientHandle) -> None:
        tab = self.tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close()

    def _renew_leases(self) -> None:
        while not self._closing.wait(LEASE_S / 3):
            for tab in list(self.tabs.values()):
                self.desk.leases.renew(tab.session.tab)


class Tab:
    """One browser tab: its session, its nodes and widgets."""

    def __init__(self, client: viser.ClientHandle, session: Session) -> None:
        self.client, self.session = client, session
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"tab-{session.tab}")
        self._view: View | None = None
        self._kind, self._camera = "", 0
        self._frame = 0
        self._prelabel = session.desk.prelabel or "ground truth"
        self._message = ""
        self._size = (0, 0)
        self._playing = False
        self._sheet_timer: threading.Timer | None = None
        self.timings_s: list[float] = []
        """How long each click took until its colours were sent."""
        calls = PanelCalls(
            act=lambda action: self._post(self._act, action),
            set_filter=lambda value: self._post(self._set_filter, value),
            open_episode=lambda name: self._post(self._open_episode, name),
            set_frame=lambda frame: self._post(self._set_frame, frame),
            set_prelabel=self._set_prelabel,
        )
        self._panel = Panel(client, calls, self._prelabel)
        client.scene.on_click()(cast(Any, self._on_click))
        client.scene.on_rect_select()(cast(Any, self._on_box))
        client.camera.on_update(self._on_camera)
        self._post(self._begin)

    def close(self) -> None:
        """Give back the lease and end the thread."""
        self._playing = False
        if self._sheet_timer is not None:
            self._sheet_timer.cancel()
        self._worker.submit(self.session.close)
        self._worker.shutdown(wait=False)

    # Events, on viser's thread.

    async def _on_click(self, event: Any) -> None:
        self._post(self._click, np.array(event.ray_origin), np.array(event.ray_direction))

    async def _on_box(self, event: Any) -> None:
        camera = self.client.camera
        R, fov, aspect = quat_wxyz_to_matrix(camera.wxyz), camera.fov, camera.aspect
        corners = [
            screen_ray(np.array(at), R, fov, aspect) for at in (event.screen_min, event.screen_max)
        ]
        self._post(self._box, np.array(camera.position), *corners)

    async def _on_camera(self, _: Any) -> None:
        size = (self.client.camera.image_width, self.client.camera.image_height)
        if size != self._size:
            # The window got its true size only after the panel was docked.
            self._size = size
            self._post(self._reset_view)

    def _post(self, work: Callable[..., None], *arguments: Any) -> None:
        try:
            self._worker.submit(self._guarded, work, *arguments)
        except RuntimeError:
            logger.debug("a tab that is closed sent another event")

    def _guarded(self, work: Callable[..., None], *arguments: Any) -> None:
        """Do one thing; what cannot be done is said in the panel, and nothing is lost."""
        try:
            work(*arguments)
        except CodeDiffuserError as error:
            self._say(str(error))
        except Exception as error:
            logger.exception("labeling window")
            self._say(f"internal error: {error!r}; your labels are kept, see the terminal")

    # Work, on the tab's thread.

    def _begin(self) -> None:
        self.session.start()
        if self.session.desk.prelabel and not self.session.draft.past:
            self._show_episode()
            self._propose()
        self._show_episode()

    def _click(self, origin: np.ndarray, direction: np.ndarray) -> None:
        began = time.perf_counter()
        view = self._view
        if view is None or view.plane is None or view.picker is None:
            return
        instance = view.picker.nearest(view.plane.from_ray(origin, direction))
        if instance is None:
            return
        view.recolor(self.session.after_toggle(instance))
        self.client.flush()
        self.timings_s.append(time.perf_counter() - began)
        self._panel.show_saved(self.session, saving=True)
        try:
            self.session.toggle(instance)
        finally:
            self._refresh()

    def _box(self, origin: np.ndarray, first: np.ndarray, second: np.ndarray) -> None:
        view = self._view
        if view is None or view.plane is None or view.picker is None:
            return
        corners = np.stack([view.plane.from_ray(origin, ray) for ray in (first, second)])
        found: list[SelectableInstance] = view.picker.inside(
            corners.min(axis=0), corners.max(axis=0)
        )
        if found:
            self.session.select_box(found)
            self._refresh()

    def _act(self, action: Action) -> None:
        self._message = ""
        session = self.session
        match action:
            case "submit":
                session.submit()
                self._forward()
            case "next" | "skip":
                self._forward()
            case "previous":
                self._move(-1)
            case "undo":
                session.undo()
            case "redo":
                session.redo()
            case "clear":
                session.clear()
            case "prelabel":
                self._propose()
            case "flag":
                session.flag(self._panel.comment)
                self._panel.clear_comment()
                self._forward()
            case "unflag":
                session.unflag()
            case "accept" | "reject":
                session.review("accept" if action == "accept" else "reject", self._panel.comment)
                self._panel.clear_comment()
                self._forward()
            case "keep_mine":
                session.keep_mine()
                self._forward()
            case "take_theirs":
                session.take_theirs()
            case "view_top" | "view_camera" | "view_3d":
                self._switch(action)
            case "reset_view":
                self._reset_view()
            case "play":
                self._play()
            case "help":
                self._panel.show_help()
        self._refresh()

    def _forward(self) -> None:
        self._move(1)

    def _move(self, step: int) -> None:
        if self.session.next(step):
            if self.session.desk.prelabel and not self.session.draft.past:
                self._propose_quietly()
            self._show_episode()
        else:
            self._message = f"no other episode is '{self.session.filter}' and free"

    def _propose(self) -> None:
        self.session.propose(self._prelabel)

    def _propose_quietly(self) -> None:
        """A pre-label on opening; where none is found the operator begins with nothing."""
        if not self.session.draft.selection:
            try:
                self._propose()
            except CodeDiffuserError as error:
                self._message = f"no pre-label: {error}"

    def _set_filter(self, value: Filter) -> None:
        self.session.filter = value
        self._message = f"{len(self.session.desk.index.ids(value, self.session.operator))} episodes"
        self._refresh()

    def _set_prelabel(self, value: str) -> None:
        self._prelabel = value

    def _open_episode(self, name: str) -> None:
        other = self.session.open(name.strip())
        self._message = f"{other} works on this episode too" if other else ""
        self._show_episode()

    # Showing.

    def _show_episode(self) -> None:
        scene = self.session.scene
        self._frame = 0
        if scene is not None and self._kind in ("", "3d"):
            self._choose_view(scene)
        self._panel.show_frame(0, scene.num_frames if scene else 1)
        self._show_view()
        self._refresh()

    def _choose_view(self, scene: EpisodeScene) -> None:
        """Begin with the view that the task names; the operator's own choice stays."""
        wanted = scene.task.config.labeling.view if scene.task else "top"
        self._kind = "camera" if wanted in scene.cameras else "top"
        if self._kind == "camera":
            self._camera = list(scene.cameras).index(wanted)

    def _show_view(self) -> None:
        scene = self.session.scene
        with self.client.atomic():
            if self._view is not None:
                self._view.remove()
                self._view = None
            if scene is not None and scene.task is not None:
                self._view = self._make_view()
                self._view.recolor(self.session.draft.selection)
        self._lock_orbit()
        self._reset_view()

    def _make_view(self) -> View:
        scene = self.session.scene
        assert scene is not None
        if self._kind == "camera" and scene.cameras:
            names = list(scene.cameras)
            return CameraView(self.client, scene, names[self._camera % len(names)])
        if self._kind == "3d":
            return CloudView(self.client, scene)
        return TopView(self.client, scene)

    def _switch(self, action: Action) -> None:
        if action == "view_camera":
            self._camera += self._kind == "camera"
            self._kind = "camera"
        else:
            self._kind = "top" if action == "view_top" else "3d"
        self._show_view()

    def _lock_orbit(self) -> None:
        """A drag selects a box in the two flat views, and turns the cloud in the third."""
        self.client.scene.remove_rect_select_callback("all")
        if self._kind != "3d":
            self.client.scene.on_rect_select()(cast(Any, self._on_box))

    def _reset_view(self) -> None:
        if self._view is not None:
            show_viewpoint(self.client, self._view.viewpoint(self.client.camera.aspect))

    def _refresh(self) -> None:
        """Bring colours and panel in line with the session."""
        if self._view is not None:
            self._view.recolor(self.session.draft.selection)
        self._panel.refresh(self.session, self._message)
        self.client.flush()
        self._sheet_soon()

    def _say(self, message: str) -> None:
        self._message = message
        self._refresh()

    def _sheet_soon(self) -> None:
        """Draw the camera pictures when the operator pauses; clicks never wait for them."""
        if self._sheet_timer is not None:
            self._sheet_timer.cancel()
        self._sheet_timer = threading.Timer(SHEET_WAIT_S, self._post, (self._draw_frame,))
        self._sheet_timer.daemon = True
        self._sheet_timer.start()

    def _draw_frame(self) -> None:
        scene = self.session.scene
        if scene is None or (frame := scene.frame(self._frame)) is None:
            return
        attention = MovingAttention(scene, self.session.draft.selection)
        self._panel.show_sheet(camera_sheet(scene, frame, attention))
        if isinstance(self._view, CloudView):
            self._view.show(*colored_cloud(scene, frame, attention))

    def _set_frame(self, frame: int) -> None:
        self._frame = frame
        self._draw_frame()

    def _play(self) -> None:
        self._playing = not self._playing
        if self._playing:
            threading.Thread(target=self._play_on, daemon=True).start()

    def _play_on(self) -> None:
        """Step through the episode until it ends or the operator stops it."""
        scene = self.session.scene
        step = max(1, round((scene.episode.hz if scene and scene.episode else 25) / PLAY_HZ))
        while self._playing and scene is self.session.scene and scene is not None:
            frame = min(self._frame + step, scene.num_frames - 1)
            self._post(self._set_frame, frame)
            self._panel.show_frame(frame, scene.num_frames)
            if frame == scene.num_frames - 1:
                self._playing = False
            time.sleep(1 / PLAY_HZ)


def check_access(host: str, token: str | None) -> None:
    """Refuse to serve other machines without a token.

    Raises:
        ConfigError: The message says what to add.
    """
    if host not in (LOCAL_HOST, "localhost", "::1") and token is None:
        raise ConfigError(
            f"--host {host} lets other machines in, so a token is required: set the environment "
            "variable CODEDIFFUSER_LABEL_TOKEN, or keep to this machine and use an ssh tunnel"
        )
    if token is not None and len(token) < MIN_TOKEN:
        raise ConfigError(f"the token has {len(token)} characters, expected at least {MIN_TOKEN}")


def _stored(client: viser.ClientHandle, key: str) -> str | None:
    """What the browser remembers under a key; None when it remembers nothing or does not answer."""
    try:
        return client.local_storage.get_item(key, timeout=2.0)
    except (RuntimeError, TimeoutError):
        return None
