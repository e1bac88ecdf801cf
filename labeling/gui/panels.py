"""The panel beside the view: widgets of one tab, and what they call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import viser

from codediffuser.labeling.gui.keys import KEYS, Action
from codediffuser.labeling.gui.prelabels import PRELABELS
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.gui.texts import headline, keys_table, notes, saved_line
from codediffuser.labeling.index import Filter

BUTTONS: dict[str, tuple[tuple[str, Action], ...]] = {
    "go": (("‹ Previous", "previous"), ("Skip", "skip"), ("Next ›", "next")),
    "select": (("Undo", "undo"), ("Redo", "redo"), ("Clear", "clear")),
    "view": (("Top", "view_top"), ("Camera", "view_camera"), ("3D", "view_3d")),
}


@dataclass(frozen=True, slots=True)
class PanelCalls:
    """What the widgets call; each takes the work to the tab's own thread."""

    act: Callable[[Action], None]
    set_filter: Callable[[Filter], None]
    open_episode: Callable[[str], None]
    set_frame: Callable[[int], None]
    set_prelabel: Callable[[str], None]


class Panel:
    """Widgets of one tab."""

    def __init__(self, client: viser.ClientHandle, calls: PanelCalls, prelabel: str) -> None:
        self._client, gui = client, client.gui
        self._headline = gui.add_html("")
        self._saved = gui.add_html("")
        self._progress: Any = gui.add_progress_bar(0.0, color="orange")
        self._notes = gui.add_html("")
        self._mode = gui.add_html("")
        submit = gui.add_button("Submit and next  (Enter)", color="orange")
        submit.on_click(_then(lambda: calls.act("submit")))
        for label, buttons in BUTTONS.items():
            group = gui.add_button_group(label, [text for text, _ in buttons])
            group.on_click(_chosen(group, dict(buttons), calls.act))
        self._slider: Any = gui.add_slider("frame", 0, 1, 1, 0)
        self._slider.on_update(_value(self._slider, calls.set_frame))
        self._sheet = gui.add_image(np.full((60, 200, 3), 230, np.uint8), format="jpeg")
        with gui.add_folder("Queue"):
            self._filter: Any = gui.add_dropdown(
                "show", get_args(Filter), initial_value="unlabeled"
            )
            self._filter.on_update(_value(self._filter, calls.set_filter))
            source = gui.add_dropdown("pre-label", PRELABELS.names(), initial_value=prelabel)
            source.on_update(_value(source, calls.set_prelabel))
            self._goto: Any = gui.add_text("go to", "", hint="id of an episode")
            go = gui.add_button("Open")
            go.on_click(_value(self._goto, calls.open_episode))
        with gui.add_folder("Flag and review", expand_by_default=False):
            self._comment: Any = gui.add_text(
                "reason", "", hint="why the episode is flagged, or its labels rejected"
            )
            for actions in (("flag", "unflag"), ("accept", "reject")):
                group = gui.add_button_group("", [a.capitalize() for a in actions])
                group.on_click(_chosen(group, {a.capitalize(): a for a in actions}, calls.act))
        show_keys = gui.add_button("Keys  (H)", color="gray")
        show_keys.on_click(_then(lambda: calls.act("help")))
        self._commands = [self._command(key.label, key.hotkey, key.action, calls) for key in KEYS]

    def _command(self, label: str, hotkey: str, action: Action, calls: PanelCalls) -> Any:
        command = self._client.gui.add_command(label, hotkey=hotkey)  # type: ignore[arg-type]
        command.on_trigger(_then(lambda: calls.act(action)))
        return command

    @property
    def comment(self) -> str:
        """Text of the reason field."""
        return str(self._comment.value)

    def clear_comment(self) -> None:
        """Empty the reason field."""
        self._comment.value = ""

    def refresh(self, session: Session, message: str, *, saving: bool = False) -> None:
        """Show where the session stands."""
        index = session.desk.index
        self._headline.content = headline(session)
        self._notes.content = notes(session, message)
        self.show_saved(session, saving=saving)
        done = index.count("labeled", "accepted")
        self._progress.value = 100.0 * done / max(1, len(index.rows))

    def show_saved(self, session: Session, *, saving: bool) -> None:
        """Say whether everything is on disk."""
        self._saved.content = saved_line(session, saving=saving)

    def show_mode(self, content: str) -> None:
        """Say in HTML what clicks mean in a special mode; empty for none."""
        self._mode.content = content

    def show_sheet(self, sheet: np.ndarray) -> None:
        """Show the camera pictures."""
        self._sheet.image = sheet

    def show_frame(self, frame: int, num_frames: int) -> None:
        """Set the slider without calling back."""
        self._slider.max = max(1, num_frames - 1)
        self._slider.value = frame

    def show_help(self) -> None:
        """Open the list of keys."""
        with self._client.gui.add_modal("Keys") as modal:
            self._client.gui.add_markdown(keys_table())
            close = self._client.gui.add_button("Close")
            close.on_click(_then(modal.close))


def ask_token(client: viser.ClientHandle, answer: Callable[[str, str], bool], name: str) -> None:
    """Ask for name and token before anything of the run is shown.

    Args:
        client: The tab.
        answer: Gets token and name; whether they were right.
        name: Proposed name.
    """
    modal = client.gui.add_modal("Sign in")
    with modal:
        client.gui.add_markdown("This labeling server asks for its token.")
        operator = client.gui.add_text("name", name)
        token = client.gui.add_text("token", "")
        said = client.gui.add_markdown("")
        enter = client.gui.add_button("Enter", color="orange")

    def check(_: Any) -> None:
        if answer(token.value, operator.value):
            modal.close()
        else:
            said.content = "Wrong token, or no name."

    enter.on_click(check)


def _then(work: Callable[[], Any]) -> Callable[[Any], Any]:
    async def call(event: Any) -> None:
        work()

    return call


def _value(widget: Any, work: Callable[[Any], None]) -> Callable[[Any], Any]:
    async def call(event: Any) -> None:
        # Without a client the value was set by us, not by the operator.
        if event.client is not None:
            work(widget.value)

    return call


def _chosen(
    group: Any, actions: dict[str, Action], act: Callable[[Action], None]
) -> Callable[[Any], Any]:
    async def call(event: Any) -> None:
        act(actions[group.value])

    return call
