"""The camera pictures beside the view, and the episode as it plays, with attention."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from codediffuser.labeling.gui.panels import Panel
from codediffuser.labeling.gui.pictures import MovingAttention, camera_sheet, colored_cloud
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.gui.stage import Stage

WAIT_S = 0.15
"""Camera pictures follow a click after so long without another one."""

PLAY_HZ = 8.0


class Reel:
    """Draws one frame of a tab's episode at a time.

    Args:
        session: What is shown and selected.
        panel: Shows the pictures and the slider.
        stage: Shows the cloud, when it is the 3D view.
        post: Takes work to the tab's own thread; all methods but `stop` belong there.
    """

    def __init__(
        self, session: Session, panel: Panel, stage: Stage, post: Callable[..., None]
    ) -> None:
        self._session, self._panel, self._stage, self._post = session, panel, stage, post
        self._frame = 0
        self._timer: threading.Timer | None = None
        self._playing = False

    def rewind(self) -> None:
        """Begin another episode at its first frame."""
        self._frame, self._playing = 0, False
        scene = self._session.scene
        self._panel.show_frame(0, scene.num_frames if scene else 1)

    def soon(self) -> None:
        """Draw when the operator pauses; clicks never wait for pictures."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(WAIT_S, self._post, (self.draw,))
        self._timer.daemon = True
        self._timer.start()

    def go_to(self, frame: int) -> None:
        """Draw another frame."""
        self._frame = frame
        self.draw()

    def draw(self) -> None:
        """Draw the frame; an episode without pictures keeps what is shown."""
        scene = self._session.scene
        if scene is None or (frame := scene.frame(self._frame)) is None:
            return
        attention = MovingAttention(scene, self._session.draft.selection)
        self._panel.show_sheet(camera_sheet(scene, frame, attention))
        if (cloud := self._stage.cloud) is not None:
            cloud.show(*colored_cloud(scene, frame, attention))

    def play(self) -> None:
        """Play the episode to its end, or stop it."""
        self._playing = not self._playing
        if self._playing:
            threading.Thread(target=self._play_on, daemon=True).start()

    def stop(self) -> None:
        """End everything that is still to come."""
        self._playing = False
        if self._timer is not None:
            self._timer.cancel()

    def _play_on(self) -> None:
        scene = self._session.scene
        if scene is None or scene.episode is None:
            return
        step = max(1, round(scene.episode.hz / PLAY_HZ))
        while self._playing and scene is self._session.scene:
            frame = min(self._frame + step, scene.num_frames - 1)
            self._post(self.go_to, frame)
            self._panel.show_frame(frame, scene.num_frames)
            if frame == scene.num_frames - 1:
                self._playing = False
            time.sleep(1 / PLAY_HZ)
