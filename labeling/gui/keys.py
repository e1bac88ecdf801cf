"""The keys of the labeling window, in the order of the help panel.

W A S D Q E and the arrows move viser's camera and are left to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Action = Literal[
    "submit", "next", "previous", "undo", "redo", "clear", "skip", "flag", "unflag", "prelabel",
    "view_top", "view_camera", "view_3d", "reset_view", "accept", "reject", "keep_mine",
    "take_theirs", "play", "references", "category", "help",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Key:
    """One command of the window."""

    action: Action
    hotkey: str
    label: str
    """What it does, for the help panel and the command palette (Ctrl+K)."""


KEYS = (
    Key("submit", "enter", "Submit and go to the next episode"),
    Key("next", "N", "Next episode"),
    Key("previous", "P", "Previous episode"),
    Key("skip", "K", "Skip: next episode, this one comes again later"),
    Key("undo", "U", "Undo"),
    Key("redo", "Y", "Redo"),
    Key("clear", "X", "Deselect everything"),
    Key("prelabel", "G", "Take the pre-label to accept or correct"),
    Key("view_top", "T", "View from above"),
    Key("view_camera", "C", "View through a camera; again for the next camera"),
    Key("view_3d", "V", "View in 3D, with the attention at the time of the slider"),
    Key("reset_view", "R", "Reset the view"),
    Key("play", "space", "Play or stop the episode"),
    Key("flag", "F", "Flag the episode with the reason in the text field"),
    Key("unflag", "B", "Withdraw the flags of the episode"),
    Key("accept", "J", "Review: accept the labels, go to the next"),
    Key("reject", "L", "Review: reject with the comment in the text field, go to the next"),
    Key("keep_mine", "M", "After a refused submit: put mine on top"),
    Key("take_theirs", "O", "Go back to the saved labels"),
    Key("references", "I", "Reference mode: a click keeps the feature of a pixel; again to leave"),
    Key("category", "Z", "Reference mode: what the next click stands for"),
    Key("help", "H", "Show the keys"),
)
"""Every command has one key, and no key has two."""
