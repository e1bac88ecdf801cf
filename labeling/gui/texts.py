"""The sentences of the panel as HTML. Everything that comes from data is escaped here."""

from __future__ import annotations

from collections.abc import Sequence

from codediffuser.labeling.gui.draft import missing, next_role
from codediffuser.labeling.gui.keys import KEYS
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.perception.references import ReferenceLibrary

_SIGNS = frozenset("&<>\"'`*_[]()!#|~\\{}$:")
"""What HTML or markdown could read as markup."""

_ROLE_COLORS = {"pick": "#ff4d00", "place": "#ff4d00"}


def escape(text: object) -> str:
    """Data as text that no browser reads as markup, in HTML and in markdown.

    Markdown passes entities through, so its own signs are written as entities too.
    """
    return "".join(f"&#{ord(c)};" if c in _SIGNS else c for c in str(text))


def headline(session: Session) -> str:
    """Which episode, the instruction, and what is still missing."""
    scene = session.scene
    if scene is None:
        return ""
    rows = session.desk.index.rows
    number = [row.episode_id for row in rows].index(scene.id) + 1
    row = session.row
    status = row.status if row else "unlabeled"
    marks = "".join(_chip(f"flag: {reason}", "#c92a2a") for reason in (row.flags if row else ()))
    if row and row.disagrees:
        marks += _chip("labelers disagree", "#e67700")
    chosen = " ".join(name for _, name in session.draft.selection)
    return (
        f'<div data-episode="{escape(scene.id)}" data-chosen="{escape(chosen)}" '
        'style="padding:4px 10px 2px;line-height:1.35">'
        f'<div style="opacity:.65;font-size:12px">episode {escape(scene.id)} &middot; '
        f"{number} of {len(rows)} &middot; {escape(status)}</div>"
        f'<div style="font-size:17px;font-weight:600;margin:3px 0 5px">'
        f"{escape(scene.instruction or 'no instruction')}</div>"
        f"{_roles(session)}{marks}</div>"
    )


def _roles(session: Session) -> str:
    counts, coming = missing(session.draft, session.needs), next_role(session.draft, session.needs)
    lines = []
    for need in session.needs:
        names = ", ".join(session.draft.chosen(need.role)) or "&mdash;"
        names = escape(names) if names != "&mdash;" else names
        count = counts[need.role]
        if count > 0:
            state = f"{count} missing" + (" &larr; click now" if need.role == coming else "")
        else:
            state = "&#10003;" if count == 0 else f"{-count} too many"
        weight = "600" if need.role == coming else "400"
        lines.append(
            f'<div style="font-weight:{weight}"><span style="color:{_ROLE_COLORS[need.role]}">'
            f"{need.role}</span> {escape(need.category)}: {names} "
            f'<span style="opacity:.65">{state}</span></div>'
        )
    return "".join(lines)


def saved_line(session: Session, *, saving: bool) -> str:
    """Whether everything is on disk, and where."""
    if saving:
        text, color, state = "saving &hellip;", "#868e96", "saving"
    elif session.submitted:
        text, color, state = "&#10003; saved as labels", "#2b8a3e", "labels"
    elif session.draft.selection or session.draft.past:
        text, color, state = "&#10003; draft saved", "#1971c2", "draft"
    else:
        text, color, state = "nothing to save", "#868e96", "nothing"
    return (
        f'<div style="padding:0 10px;color:{color};font-size:12px" data-saved="{state}">'
        f"{text} &middot; {escape(session.operator)}</div>"
    )


def notes(session: Session, message: str) -> str:
    """Warnings, problems and the last message; empty when there is nothing to say."""
    lines = []
    if message:
        lines.append(_box(message, "#e7f5ff", "#1864ab"))
    if session.problem:
        lines.append(_box(session.problem, "#fff5f5", "#c92a2a"))
    if session.stale is not None:
        by = session.stale.saved.by if session.stale.saved else "a program"
        lines.append(
            _box(
                f"{by} saved revision {session.stale.revision} meanwhile. Your selection is kept: "
                "M puts it on top, O takes theirs.", "#fff9db", "#e67700",
            )
        )  # fmt: skip
    document = session.document
    if document is not None and document.status == "rejected":
        lines.append(_box(f"rejected: {document.reviews[-1].comment}", "#fff5f5", "#c92a2a"))
    lines += [_box(text, "#fff9db", "#e67700") for text in session.warnings()]
    return "".join(lines)


def reference_line(
    library: ReferenceLibrary | None, backend: str, categories: Sequence[str], chosen: str
) -> str:
    """Reference mode: what a click stands for, and what the library holds."""
    counts = {c: library.count(c) if library else 0 for c in categories}
    said = " &middot; ".join(
        f"<b>{escape(c)}: {n}</b>" if c == chosen else f"{escape(c)}: {n}"
        for c, n in counts.items()
    )
    threshold = ""
    if library is not None:
        how = "calibrated" if library.calibrated else "default"
        threshold = f"<br>similarity that counts: {library.threshold:.2f}, {how}"
    state = " ".join(f"{c}:{n}" for c, n in counts.items())
    return (
        f'<div data-references="{escape(state)}" '
        f'data-category="{escape(chosen)}" '
        'style="background:#e6fcf5;color:#087f5b;border-radius:6px;padding:4px 8px;margin:2px 10px;'
        f'font-size:12px">Reference mode, {escape(backend)}: a click keeps the pixel as '
        f"<b>{escape(chosen)}</b> (Z changes it, U takes back, I leaves)<br>{said}{threshold}</div>"
    )


def keys_table() -> str:
    """The help panel, as markdown."""
    rows = "\n".join(f"| **{k.hotkey.capitalize()}** | {k.label} |" for k in KEYS)
    mouse = (
        "Click near an instance to select it, click again to deselect. "
        "Drag a box to select several. Right-drag pans, the wheel zooms."
    )
    return f"{mouse}\n\n| key | |\n|---|---|\n{rows}"


def _chip(text: str, color: str) -> str:
    return (
        f'<span style="background:{color};color:#fff;border-radius:8px;padding:1px 7px;'
        f'font-size:11px;margin-right:4px">{escape(text)}</span>'
    )


def _box(text: str, background: str, color: str) -> str:
    return (
        f'<div style="background:{background};color:{color};border-radius:6px;padding:4px 8px;'
        f'margin:2px 10px;font-size:12px">{escape(text)}</div>'
    )
