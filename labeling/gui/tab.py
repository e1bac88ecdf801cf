"""One browser tab: what its events do, in their order, on a thread of its own.

What the browser shows first is the recoloured instance, then the action goes to disk, then the
panel says that it is saved.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import numpy as np

from codediffuser.errors import CodeDiffuserError
from codediffuser.labeling.gui.keys import Action
from codediffuser.labeling.gui.panels import Panel, PanelCalls
from codediffuser.labeling.gui.planes import screen_ray
from codediffuser.labeling.gui.reel import Reel
from codediffuser.labeling.gui.reference_tool import ReferenceTool
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.gui.stage import Stage
from codediffuser.labeling.gui.views import ClientHandle
from codediffuser.labeling.index import Filter
from codediffuser.poses import quat_wxyz_to_matrix

logger = logging.getLogger(__name__)


class Tab:
    """One browser tab: its session, its nodes and widgets."""

    def __init__(self, client: ClientHandle, session: Session) -> None:
        self.client, self.session = client, session
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"tab-{session.tab}")
        self._prelabel = session.desk.prelabel or "ground truth"
        self._message = ""
        self._size = (0, 0)
        self.timings_s: list[float] = []
        """How long each click took until its colours were sent."""
        calls = PanelCalls(
            act=lambda action: self._post(self._act, action),
            set_filter=lambda value: self._post(self._set_filter, value),
            open_episode=lambda name: self._post(self._open_episode, name),
            set_frame=lambda frame: self._post(self._reel.go_to, frame),
            set_prelabel=self._set_prelabel,
        )
        self._panel = Panel(client, calls, self._prelabel)
        self._stage = Stage(client)
        self._references = ReferenceTool(
            self._panel.show_mode,
            self._stage,
            session.desk.references,
            session.operator,
        )
        self._reel = Reel(session, self._panel, self._stage, self._post)
        client.scene.on_click()(cast(Any, self._on_click))
        client.scene.on_rect_select()(cast(Any, self._on_box))
        client.camera.on_update(self._on_camera)
        self._post(self._begin)

    def close(self) -> None:
        """Give back the lease and end the thread."""
        self._reel.stop()
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
            self._post(self._stage.reset)

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
        if self._references.active and self.session.scene is not None:
            self._say(self._references.click(self.session.scene, origin, direction))
            return
        began = time.perf_counter()
        instance = self._stage.pick(origin, direction)
        if instance is None:
            return
        self._stage.recolor(self.session.after_toggle(instance))
        self.client.flush()
        self.timings_s.append(time.perf_counter() - began)
        self._panel.show_saved(self.session, saving=True)
        try:
            self.session.toggle(instance)
        finally:
            self._refresh()

    def _box(self, origin: np.ndarray, first: np.ndarray, second: np.ndarray) -> None:
        found = self._stage.inside(origin, first, second)
        if found and not self._references.active:
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
            case "undo" if self._references.active:
                self._message = self._references.undo(session.scene)
            case "references":
                self._references.toggle(session.scene)
                self._lock_orbit()
            case "category":
                self._references.next_category(session.scene)
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
                self._switch(action.removeprefix("view_"))
            case "reset_view":
                self._stage.reset()
            case "play":
                self._reel.play()
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
        self._reel.rewind()
        self._stage.show(self.session.scene, self.session.draft.selection)
        self._references.refresh(self.session.scene)
        self._lock_orbit()
        self._refresh()

    def _switch(self, kind: str) -> None:
        self._stage.switch(kind, self.session.draft.selection)
        self._references.refresh(self.session.scene)
        self._lock_orbit()

    def _lock_orbit(self) -> None:
        """A drag selects a box where targets can be chosen, and turns the cloud in 3D."""
        self.client.scene.remove_rect_select_callback("all")
        if self._stage.selects:
            self.client.scene.on_rect_select()(cast(Any, self._on_box))

    def _refresh(self) -> None:
        """Bring colours and panel in line with the session."""
        self._stage.recolor(self.session.draft.selection)
        self._panel.refresh(self.session, self._message)
        self.client.flush()
        self._reel.soon()

    def _say(self, message: str) -> None:
        self._message = message
        self._refresh()
