"""What an operator has selected in one episode, with undo and redo. Pure values, no files.

Every change is a new `Draft`. Selections are a few ids, so the past is kept as whole selections,
without limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from codediffuser.errors import LabelError
from codediffuser.labeling.instances import SelectableInstance
from codediffuser.labeling.label import ROLES, Role

Selection = tuple[tuple[Role, str], ...]
"""(role, instance id), in the order they were chosen; no id twice."""


@dataclass(frozen=True, slots=True)
class RoleNeed:
    """How many instances a role takes."""

    role: Role
    category: str
    count: int = 1


@dataclass(frozen=True, slots=True)
class Draft:
    """A selection, what it was before, and what was undone."""

    selection: Selection = ()
    past: tuple[Selection, ...] = ()
    """Oldest first."""
    future: tuple[Selection, ...] = ()
    """Next redo last."""
    prelabel: str | None = None
    """Where a proposal came from that was taken over at some time."""

    def chosen(self, role: Role) -> tuple[str, ...]:
        """Ids selected for a role, in order."""
        return tuple(name for r, name in self.selection if r == role)

    def role_of(self, instance_id: str) -> Role | None:
        """The role that an instance is selected for; None when it is not."""
        return next((role for role, name in self.selection if name == instance_id), None)

    def with_selection(self, selection: Selection, prelabel: str | None = None) -> Draft:
        """Select something else; an equal selection adds no step to undo."""
        if selection == self.selection:
            return replace(self, prelabel=prelabel or self.prelabel)
        past = (*self.past, self.selection)
        return Draft(selection, past, (), prelabel or self.prelabel)

    def undo(self) -> Draft:
        """One step back; the same draft when there is none."""
        if not self.past:
            return self
        future = (*self.future, self.selection)
        return replace(self, selection=self.past[-1], past=self.past[:-1], future=future)

    def redo(self) -> Draft:
        """One step forth again; the same draft when there is none."""
        if not self.future:
            return self
        past = (*self.past, self.selection)
        return replace(self, selection=self.future[-1], past=past, future=self.future[:-1])


def missing(draft: Draft, needs: Sequence[RoleNeed]) -> dict[Role, int]:
    """How many more instances each role takes; negative when too many are selected."""
    return {need.role: need.count - len(draft.chosen(need.role)) for need in needs}


def next_role(draft: Draft, needs: Sequence[RoleNeed]) -> Role | None:
    """The role that is filled next, in the task's order; None when all are full."""
    open_roles = missing(draft, needs)
    return next((need.role for need in needs if open_roles[need.role] > 0), None)


def complete(draft: Draft, needs: Sequence[RoleNeed]) -> bool:
    """Whether every role has exactly what it takes."""
    return all(count == 0 for count in missing(draft, needs).values())


def require_complete(draft: Draft, needs: Sequence[RoleNeed]) -> None:
    """Raise `LabelError` with what is missing or too many, unless the draft is complete."""
    if complete(draft, needs):
        return
    counts = missing(draft, needs)
    said = []
    for need in needs:
        count = counts[need.role]
        if count > 0:
            said.append(f"{count} {need.category} to {need.role} is missing")
        elif count < 0:
            said.append(f"{-count} {need.category} too many to {need.role}")
    raise LabelError("; ".join(said) or "nothing can be selected in this episode")


def toggle(draft: Draft, instance: SelectableInstance, needs: Sequence[RoleNeed]) -> Draft:
    """Select an instance, or deselect it when it is selected.

    It takes its own role, or the next open one when it may be either; in a full role it replaces
    the instance that was chosen first, so that a wrong click is mended by the right one.
    """
    if draft.role_of(instance.id) is not None:
        kept = tuple(item for item in draft.selection if item[1] != instance.id)
        return draft.with_selection(kept)
    role = instance.role or next_role(draft, needs) or needs[-1].role
    mine, limit = draft.chosen(role), _count(needs, role)
    dropped = mine[: max(0, len(mine) + 1 - limit)]
    kept = tuple(item for item in draft.selection if item[1] not in dropped)
    return draft.with_selection((*kept, (role, instance.id)))


def select_box(
    draft: Draft, instances: Sequence[SelectableInstance], needs: Sequence[RoleNeed]
) -> Draft:
    """Take all of several instances; roles that none of them has keep what they had.

    A role may then hold more than it takes: the operator deselects the surplus. Instances that
    may be either fill the open roles in order.
    """
    found: dict[Role, list[str]] = {role: [] for role in ROLES}
    for instance in instances:
        still_open = [n.role for n in needs if len(found[n.role]) < n.count]
        found[instance.role or (*still_open, needs[-1].role)[0]].append(instance.id)
    taken = {name for names in found.values() for name in names}
    kept = tuple(x for x in draft.selection if not found[x[0]] and x[1] not in taken)
    return draft.with_selection(
        (*kept, *((role, name) for role in ROLES for name in found[role]))
    )  # fmt: skip


def _count(needs: Sequence[RoleNeed], role: Role) -> int:
    return next((need.count for need in needs if need.role == role), 1)
