"""One tab's work: which episode it shows, what is selected, and what its actions do. No viser.

Every method that changes something returns after the change is on disk: drafts in the operator's
journal, labels, flags and reviews in the label store. A method that cannot do what it was asked to
raises a `CodeDiffuserError` with the sentence to show, and changes nothing.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence

from codediffuser import __version__
from codediffuser.errors import CodeDiffuserError, LabelError, StaleLabelError
from codediffuser.labeling.gui.checks import warnings
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.draft import (
    Draft,
    RoleNeed,
    Selection,
    require_complete,
    select_box,
    toggle,
)
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.journal import Based, Chosen, Entry, Opened, Stepped
from codediffuser.labeling.gui.prelabels import propose
from codediffuser.labeling.index import Filter, IndexRow
from codediffuser.labeling.instances import SelectableInstance
from codediffuser.labeling.label import Provenance, utc_now
from codediffuser.labeling.label_document import LabelsDocument, Saving, Verdict
from codediffuser.labeling.marks import add_flag, add_review, withdraw_flags
from codediffuser.labeling.store import load_document, save_labels

IDLE_S = 60.0
"""A longer pause between two actions counts as that much work."""


class Session:
    """The work of one operator in one tab. Not thread-safe: call it from one thread at a time.

    Args:
        desk: What the tabs share.
        operator: Name of the labeler, stored with the labels.
    """

    def __init__(self, desk: Desk, operator: str) -> None:
        if not operator.strip():
            raise LabelError("an operator needs a name: it is stored with every label")
        self.desk, self.operator = desk, operator.strip()
        self.tab = secrets.token_hex(4)
        self.filter: Filter = "unlabeled"
        self.scene: EpisodeScene | None = None
        self.document: LabelsDocument | None = None
        """Labels on disk when they were last looked at; None when there are none."""
        self.stale: LabelsDocument | None = None
        """Labels that somebody else saved meanwhile, after a submit was refused."""
        self.problem = ""
        """Why this episode cannot be labelled: damaged files, nothing to see. Empty when it can."""
        self._journal = desk.journal(self.operator)
        self._entry = Entry(draft=Draft(), base_revision=0)
        self._seconds, self._acted_at = 0.0, desk.clock()

    @property
    def draft(self) -> Draft:
        """What is selected."""
        return self._entry.draft

    @property
    def needs(self) -> Sequence[RoleNeed]:
        """The roles of the episode's task."""
        return self.scene.needs if self.scene else ()

    @property
    def submitted(self) -> bool:
        """Whether the selection is the one in the label store."""
        return self._entry.submitted

    @property
    def row(self) -> IndexRow | None:
        """What the index says of the episode."""
        rows = self.desk.index.rows
        return next((r for r in rows if self.scene and r.episode_id == self.scene.id), None)

    def warnings(self) -> list[str]:
        """What is doubtful about the selection."""
        return warnings(self.scene, self.draft) if self.scene else []

    # Moving between episodes.

    def start(self) -> None:
        """Go on with the episode that this operator was last at, or take the next of the filter."""
        for episode, tab in reversed(self._journal.last.items()):
            entry = self._journal.entries[tab, episode]
            known = any(row.episode_id == episode for row in self.desk.index.rows)
            if known and not entry.submitted and self.desk.leases.claim(
                [episode], self.tab, self.operator
            ):  # fmt: skip
                self._open(episode)
                return
        if not self.next():
            self._open(self.desk.index.rows[0].episode_id)

    def next(self, step: int = 1) -> bool:
        """Go to the next (-1: previous) episode of the filter that no other tab works on.

        Returns:
            Whether there is one; without one the tab stays where it is.
        """
        here = self.scene.id if self.scene else None
        wanted = self.desk.after(here, self.filter, self.operator, step=step)
        episode = self.desk.leases.claim(wanted, self.tab, self.operator)
        if episode is None:
            return False
        self._open(episode)
        if step == 1 and (coming := self.desk.after(episode, self.filter, self.operator)):
            self.desk.scenes.prefetch(self.desk.folder(coming[0]))
        return True

    def open(self, episode: str) -> str | None:
        """Open an episode by id, whoever else may work on it.

        Returns:
            Name of the other operator who works on it; None when nobody does.

        Raises:
            LabelError: The run has no such episode.
        """
        known = [row.episode_id for row in self.desk.index.rows]
        if episode not in known:
            raise LabelError(f"{self.desk.run}: no episode '{episode}', the first is '{known[0]}'")
        self.desk.leases.claim([episode], self.tab, self.operator)
        self._open(episode)
        return self.desk.leases.other(episode, self.tab)

    def close(self) -> None:
        """Give the episode back to the queue; the draft stays."""
        self.desk.leases.release(self.tab)

    # Selecting.

    def after_toggle(self, instance: SelectableInstance) -> Selection:
        """What `toggle` would select; the window shows it before it is on disk."""
        return toggle(self.draft, instance, self.needs).selection

    def toggle(self, instance: SelectableInstance) -> None:
        """Select an instance, or deselect it."""
        self._select(self.after_toggle(instance))

    def select_box(self, instances: Sequence[SelectableInstance]) -> None:
        """Take all instances of a box."""
        self._select(select_box(self.draft, instances, self.needs).selection)

    def clear(self) -> None:
        """Deselect everything."""
        self._select(())

    def propose(self, prelabel: str) -> None:
        """Take over a pre-label, to accept or correct."""
        self._select(propose(prelabel, self._shown()), prelabel)

    def undo(self) -> None:
        """One step back."""
        self._step("undo")

    def redo(self) -> None:
        """One step forth."""
        self._step("redo")

    # What others see.

    def submit(self) -> LabelsDocument:
        """Save the selection as the episode's labels.

        Raises:
            StaleLabelError: Somebody else saved labels since this draft began; `stale` holds them,
                and `keep_mine` or `take_theirs` goes on.
            LabelError: A role has too few or too many targets.
        """
        scene = self._shown()
        require_complete(self.draft, self.needs)
        self._tick()
        seconds = round(self._seconds, 1)
        saved = Saving(
            by=self.operator, at=utc_now(), seconds=seconds, prelabel=self.draft.prelabel
        )
        provenance = Provenance("human", self.operator, __version__, 1.0, saved.at)
        try:
            labels = save_labels(
                scene.folder,
                scene.labels(self.draft.selection, provenance),
                expected_revision=self._entry.base_revision,
                saved=saved,
            )
        except StaleLabelError:
            self.stale = load_document(scene.folder)
            raise
        self.document, self.stale = labels.document, None
        self._rebase(labels.revision, submitted=True)
        self.desk.changed(scene.id)
        return labels.document

    def keep_mine(self) -> LabelsDocument:
        """After a refused submit: put the selection on top of what somebody else saved."""
        if self.stale is None:
            raise LabelError("nobody else changed these labels; there is nothing to decide")
        self._rebase(self.stale.revision, submitted=False)
        return self.submit()

    def take_theirs(self) -> None:
        """Take over the labels on disk; the own selection is one undo away."""
        theirs = load_document(self._shown().folder)
        if theirs is None or theirs.revision == 0:
            raise LabelError("there are no saved labels to go back to")
        self._select(_selection(theirs))
        self._rebase(theirs.revision, submitted=True)
        self.document, self.stale = theirs, None

    def flag(self, reason: str) -> None:
        """Say what is wrong with the episode; it leaves the queue until the flag is withdrawn."""
        if not reason.strip():
            raise LabelError("a flag needs a reason: write what is wrong with the episode")
        scene = self._shown()
        self.document = add_flag(scene.folder, reason.strip(), by=self.operator, at=utc_now())
        self.desk.changed(scene.id)

    def unflag(self) -> None:
        """Withdraw all flags of the episode."""
        scene = self._shown()
        self.document = withdraw_flags(scene.folder, by=self.operator, at=utc_now())
        self.desk.changed(scene.id)

    def review(self, verdict: Verdict, comment: str = "") -> None:
        """Accept or reject the labels that are shown.

        Raises:
            StaleLabelError: Others are there by now.
            LabelError: There are none, the draft differs from them, or a rejection says no reason.
        """
        scene = self._shown()
        if self.document is None or self.document.revision == 0:
            raise LabelError("there are no labels to review: submit some first")
        if self.draft.selection and set(self.draft.selection) != set(_selection(self.document)):
            raise LabelError(
                "the selection differs from the saved labels: submit it, or go back to the saved"
            )
        if verdict == "reject" and not comment.strip():
            raise LabelError("a rejection needs a comment: write what to do differently")
        self.document = add_review(
            scene.folder, verdict, comment.strip(), by=self.operator, at=utc_now(),
            expected_revision=self.document.revision,
        )  # fmt: skip
        self.desk.changed(scene.id)

    # Inside.

    def _shown(self) -> EpisodeScene:
        if self.scene is None or self.scene.episode is None:
            problem = self.scene.problem if self.scene else "no episode is open"
            raise LabelError(problem)
        return self.scene

    def _open(self, episode: str) -> None:
        self._seconds, self._acted_at = 0.0, self.desk.clock()
        self.scene = self.desk.scene(episode)
        self.stale, self.document, self.problem = None, None, self.scene.problem
        try:
            self.document = load_document(self.scene.folder)
        except CodeDiffuserError as error:
            self.problem = str(error)
        self._entry = self._enter(episode)

    def _enter(self, episode: str) -> Entry:
        """Go on with the operator's unfinished draft, or begin one at the labels on disk."""
        revision = self.document.revision if self.document else 0
        earlier = self._journal.latest(episode)
        begun = earlier is not None and (earlier[1].draft.past or earlier[1].draft.future)
        if earlier is not None and begun and not self._passed_by(earlier[1], revision):
            goes_on: str | None = earlier[0]
            selection: Selection = ()
        else:
            goes_on, selection = None, self._first_selection()
        return self._journal.write(
            Opened(
                tab=self.tab, episode=episode, at=utc_now(), goes_on_from=goes_on,
                base_revision=revision, selection=selection,
            )
        )  # fmt: skip

    def _passed_by(self, entry: Entry, revision: int) -> bool:
        """Whether a draft was submitted and others have changed the labels since."""
        return entry.submitted and entry.base_revision != revision

    def _first_selection(self) -> Selection:
        """The labels on disk; a second opinion begins with none, so that it is one's own."""
        if self.document is None or self.document.revision == 0:
            return ()
        if self.filter == "second opinion" and self.operator not in (
            self.document.latest_by_labeler()
        ):
            return ()
        return _selection(self.document)

    def _select(self, selection: Selection, prelabel: str | None = None) -> None:
        scene = self._shown()
        self._tick()
        self._entry = self._journal.write(
            Chosen(
                tab=self.tab, episode=scene.id, at=utc_now(), selection=selection,
                prelabel=prelabel,
            )
        )  # fmt: skip

    def _step(self, op: str) -> None:
        scene = self._shown()
        self._tick()
        step = Stepped.model_validate(
            {"op": op, "tab": self.tab, "episode": scene.id, "at": utc_now()}
        )
        self._entry = self._journal.write(step)

    def _rebase(self, revision: int, *, submitted: bool) -> None:
        self._entry = self._journal.write(
            Based(
                tab=self.tab, episode=self._shown().id, at=utc_now(), revision=revision,
                submitted=submitted,
            )
        )  # fmt: skip

    def _tick(self) -> None:
        now = self.desk.clock()
        self._seconds += min(now - self._acted_at, IDLE_S)
        self._acted_at = now


def _selection(document: LabelsDocument) -> Selection:
    return tuple((entry.role, entry.instance_id) for entry in document.labels)
